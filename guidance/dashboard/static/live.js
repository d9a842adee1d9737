/** The connection to the dashboard's server: what it says, and that it says something at all. */

/** What the server says comes every 0.2 s at least. */
const SILENT_MS = 700;
/** An order that moves a vehicle rests on what was heard no longer ago. */
const FRESH_MS = 3000;
/** A connection that brought nothing for so long, or does not come about, is given up for another. */
const GIVEN_UP_MS = 5000;
const RETRY_MS = 1000;
const LOOK_MS = 250;

/**
 * @param {object} on
 * @param {(said: object) => void} on.said JSON that came
 * @param {(rows: Float32Array) => void} on.rows rows of the vehicle that is seen
 * @param {(trouble: string, forS: number) => void} on.trouble why what is shown may be old, and since when; empty if it is not
 * @param {() => void} on.open a connection was opened
 * @param {() => void} on.lost it was lost
 */
export function connect(on) {
  /** @type {WebSocket} */
  let socket;
  let triedMs = 0;
  let heardMs = performance.now();
  let everHeard = false;
  const quietMs = () => performance.now() - heardMs;

  function open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    triedMs = performance.now();
    socket = new WebSocket(`${scheme}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => {
      heardMs = performance.now();
      everHeard = true;
      if (typeof data === "string") on.said(JSON.parse(data));
      else on.rows(new Float32Array(data));
    };
    socket.onopen = on.open;
    socket.onclose = () => {
      on.lost();
      setTimeout(open, RETRY_MS);
    };
  }

  /** What answers late is of no interest any more. */
  function giveUp() {
    socket.onmessage = socket.onopen = socket.onclose = null;
    socket.close();
    on.lost();
    open();
  }

  // A server that has died with its machine, or whose network has, closes nothing: only the clock tells.
  setInterval(() => {
    const quiet = quietMs();
    const open = socket.readyState === WebSocket.OPEN;
    if (open && quiet < SILENT_MS) on.trouble("", 0);
    else if (everHeard) on.trouble("Nothing comes from the dashboard's server: what is shown is old.", quiet / 1000);
    else if (quiet > 2 * SILENT_MS) on.trouble("The dashboard's server does not answer.", quiet / 1000);
    const waitedMs = Math.min(quiet, performance.now() - triedMs);
    if (socket.readyState !== WebSocket.CLOSED && waitedMs > GIVEN_UP_MS) giveUp();
  }, LOOK_MS);
  open();

  return {
    /**
     * Send; false if there is no connection, and then nothing is sent later either.
     * @param {object} message @param {boolean} [fresh] only if something was heard just now
     */
    send(message, fresh = false) {
      if (socket.readyState !== WebSocket.OPEN || (fresh && quietMs() > FRESH_MS)) return false;
      socket.send(JSON.stringify(message));
      return true;
    },
  };
}
