import json
import sys

import zenoh

config = zenoh.Config()
config.insert_json5("connect/endpoints", json.dumps(sys.argv[1:] or ["tcp/127.0.0.1:7447"]))
with zenoh.open(config) as session:
    subscriber = session.declare_subscriber("guidance/*/status")
    for sample in subscriber:
        status = json.loads(sample.payload.to_bytes())
        print(sample.key_expr, status["state"], status["reason"], flush=True)
