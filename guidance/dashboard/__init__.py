"""The page of `guidance dashboard`: every vehicle on the network in a browser, from zenoh alone.

`hub` makes rows and words of what arrives, `pages` knows what each page is owed, `server` is the shell around
them. The page itself is in `static`, as plain modules. Needs the extra `dashboard`.
"""
