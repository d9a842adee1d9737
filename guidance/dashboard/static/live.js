/** The connection to the dashboard's server: what it says, and that it says something at all. */

const SILENT_MS = 1000;
const RETRY_MS = 1000;

/**
 * @param {object} on
 * @param {(said: object) => void} on.said JSON that came
 * @param {(rows: Float32Array) => void} on.rows rows of the vehicle that is seen
 * @param {(trouble: string) => void} on.trouble why what is shown may be old; empty if it is not
 * @param {() => void} on.open a connection was opened
 * @param {() => void} on.lost it was lost
 */
export function connect(on) {
  /** @type {WebSocket} */
  let socket;
  let heardMs = performance.now();
  let everMs = 0;

  function open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    socket = new WebSocket(`${scheme}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => {
      heardMs = everMs = performance.now();
      if (typeof data === "string") on.said(JSON.parse(data));
      else on.rows(new Float32Array(data));
    };
    socket.onopen = on.open;
    socket.onclose = () => {
      on.lost();
      setTimeout(open, RETRY_MS);
    };
  }

  // A server that has died with its machine closes nothing: only the clock tells.
  setInterval(() => {
    const quietMs = performance.now() - heardMs;
    const open = socket.readyState === WebSocket.OPEN;
    if (open && quietMs < SILENT_MS) on.trouble("");
    else if (!everMs) on.trouble(quietMs < 2 * SILENT_MS ? "" : "The dashboard's server does not answer; trying again.");
    else {
      const since = `${Math.round(quietMs / 1000)} s`;
      on.trouble(`Nothing from the dashboard's server for ${since}: what is shown is old.${open ? "" : " Connecting again."}`);
    }
  }, 250);
  open();

  return {
    /** Send; false if there is no connection, and then nothing is sent later either. @param {object} message */
    send(message) {
      if (socket.readyState !== WebSocket.OPEN || performance.now() - heardMs > 3 * SILENT_MS) return false;
      socket.send(JSON.stringify(message));
      return true;
    },
  };
}
