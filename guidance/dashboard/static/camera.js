/** Where the scene is looked at from, and how mouse, touch and keys change that. Up is up: NED's down is turned. */

const FIRST = { turn: -0.6, tilt: 0.95 };
const TOP = { turn: 0, tilt: 0 };
/** What buttons above and the scale below need of the height, px. */
const ABOVE = 55;
const BELOW = 35;

export class Camera {
  constructor() {
    this.follow = false;
    this.scale = 1;
    /** Turned about the vertical, rad: 0 has north away from the viewer. */
    this.turn = FIRST.turn;
    /** From straight above, rad. */
    this.tilt = FIRST.tilt;
    this.aim(0, 0, 0);
    /** Moved on the screen, px. */
    this.shift = [0, 0];
    /** What is to be seen must be framed anew. */
    this.unframed = true;
    this.across = this.tall = 1;
    this.lens(1, 1);
  }

  /** What is in the middle of the view, m. @param {number} north @param {number} east @param {number} down */
  aim(north, east, down) {
    this.north = north;
    this.east = east;
    this.down = down;
  }

  /** A box of this size fills the view, as it is seen now. @param {number[]} size north, east and down, m */
  frame([north, east, down]) {
    const [c, s] = [Math.abs(Math.cos(this.turn)), Math.abs(Math.sin(this.turn))];
    this.across = east * c + north * s;
    this.tall = (north * c + east * s) * Math.cos(this.tilt) + down * Math.sin(this.tilt);
    this.unframed = false;
  }

  /** The view has so many pixels. @param {number} width @param {number} height */
  lens(width, height) {
    this.width = width;
    this.height = height;
    this.perMetre = this.scale * Math.min((0.9 * width) / this.across, (height - ABOVE - BELOW) / this.tall);
    this.middle = [width / 2 + this.shift[0], (height + ABOVE - BELOW) / 2 + this.shift[1]];
    this.cosTurn = Math.cos(this.turn);
    this.sinTurn = Math.sin(this.turn);
    this.cosTilt = Math.cos(this.tilt);
    this.sinTilt = Math.sin(this.tilt);
  }

  /**
   * Where a place is on the screen: an orthographic view.
   * @param {number} north @param {number} east @param {number} down
   * @returns {[number, number]}
   */
  place(north, east, down) {
    const [x, y] = this.direction(north - this.north, east - this.east, down - this.down);
    return [this.middle[0] + this.perMetre * x, this.middle[1] + this.perMetre * y];
  }

  /** A vector in local NED as it looks, in pixels for a metre's worth of one. @param {number} n @param {number} e @param {number} d */
  direction(n, e, d) {
    const right = e * this.cosTurn + n * this.sinTurn;
    const away = n * this.cosTurn - e * this.sinTurn;
    return [right, -away * this.cosTilt + d * this.sinTilt];
  }

  /** @param {number} turn @param {number} tilt */
  orbit(turn, tilt) {
    this.turn += turn;
    this.tilt = Math.min(Math.PI / 2, Math.max(0, this.tilt + tilt));
  }

  /** @param {number} times */
  zoom(times) {
    this.scale = Math.min(200, Math.max(0.02, this.scale * times));
  }

  /** What is held goes along. @param {number} x @param {number} y px */
  pan(x, y) {
    this.shift = [this.shift[0] + x, this.shift[1] + y];
  }

  /** All of what is there, in the middle, from where it is looked at now. */
  whole() {
    this.scale = 1;
    this.shift = [0, 0];
    this.unframed = true;
  }

  fit() {
    this.whole();
    this.follow = false;
    if (this.tilt === 0) Object.assign(this, FIRST);
  }

  top() {
    Object.assign(this, TOP);
    this.unframed = true;
  }
}

/**
 * @param {Camera} camera @param {HTMLCanvasElement} canvas @param {HTMLElement} buttons @param {() => void} changed
 */
export function handle(camera, canvas, buttons, changed) {
  const follow = /** @type {HTMLElement} */ (buttons.querySelector("[data-camera=follow]"));
  /** @type {Record<string, () => void>} */
  const acts = {
    in: () => camera.zoom(1.25),
    out: () => camera.zoom(0.8),
    fit: () => camera.fit(),
    top: () => camera.top(),
    follow: () => { camera.follow = !camera.follow; },
    left: () => camera.orbit(-0.1, 0),
    right: () => camera.orbit(0.1, 0),
    up: () => camera.orbit(0, -0.08),
    down: () => camera.orbit(0, 0.08),
  };
  const keys = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down", "+": "in", "=": "in", "-": "out", 0: "fit", t: "top", f: "follow" };
  const act = (/** @type {string} */ name) => {
    acts[name]();
    follow.setAttribute("aria-pressed", String(camera.follow));
    changed();
  };
  buttons.addEventListener("click", (event) => {
    const name = /** @type {HTMLElement} */ (event.target).dataset.camera;
    if (name) act(name);
  });
  canvas.addEventListener("keydown", (event) => {
    const name = event.ctrlKey || event.metaKey || event.altKey ? undefined : keys[event.key];
    if (!name) return;
    event.preventDefault();
    act(name);
  });

  /** @type {Map<number, [number, number]>} */
  const held = new Map();
  /** How far two fingers are apart, and how low they are, px. */
  const pair = () => {
    const [a, b] = [...held.values()];
    return [Math.hypot(a[0] - b[0], a[1] - b[1]), (a[1] + b[1]) / 2];
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const from = held.get(event.pointerId);
    if (!from) return;
    const before = held.size === 2 ? pair() : [0, 0];
    held.set(event.pointerId, [event.clientX, event.clientY]);
    const [x, y] = [event.clientX - from[0], event.clientY - from[1]];
    if (held.size === 2 && before[0] > 0) {
      // One finger up and down is the page's; two tilt.
      const now = pair();
      camera.zoom(now[0] / before[0]);
      camera.orbit(0, (before[1] - now[1]) * 0.008);
    } else if (held.size === 1 && event.shiftKey) camera.pan(x, y);
    else if (held.size === 1) camera.orbit(-x * 0.008, -y * 0.008); // what is near goes with the hand
    changed();
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => held.delete(/** @type {PointerEvent} */ (event).pointerId));
  }
  canvas.addEventListener("wheel", (event) => {
    // A page that scrolls by must not stop here: who has clicked into the scene means it.
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    camera.zoom(Math.exp(-event.deltaY * 0.0015));
    changed();
  }, { passive: false });
}
