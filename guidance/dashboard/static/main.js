/** The page: what comes from the server goes to the parts that show it, and clicks go back. */

import { handle } from "./camera.js";
import { Charts } from "./charts.js";
import { Events } from "./events.js";
import { FleetTable } from "./fleet.js";
import { connect } from "./live.js";
import { Orders } from "./orders.js";
import { Rows } from "./rows.js";
import { Scene } from "./scene.js";
import { theme } from "./theme.js";
import { VehiclePanel } from "./vehicle.js";
import { make, put } from "./words.js";

const $ = (/** @type {string} */ id) => /** @type {any} */ (document.getElementById(id));

/** The vehicle that an address asks for; a hash that is no name asks for none. @param {string} hash */
function named(hash) {
  const name = hash.slice(1);
  return /^[\w.-]{1,64}$/.test(name) ? name : "";
}

const rows = new Rows();
const charts = new Charts($("charts"));
const scene = new Scene($("scene"));
const panel = new VehiclePanel();
const events = new Events($("event-list"), $("events-all"));
const fleet = new FleetTable($("fleet"), see);
const orders = new Orders((message) => live.send(message));
let windowS = 60;
let shown = named(location.hash);
/** @type {any[]} */
let seen = [];

/** How drawing goes, for who measures. */
const drawn = { frames: 0, ms: 0, worst: 0 };
Object.assign(window, { drawn });

/** Which page this is, as the server said first. */
let page = "";
let pending = false;
let lastMs = 0;

/** Draw soon, but no more than 20 times a second, and never more than half of the time. */
function redraw() {
  if (pending || document.hidden) return;
  pending = true;
  const pauseMs = Math.max(45, 2 * lastMs) - (performance.now() - redraw.atMs);
  setTimeout(() => requestAnimationFrame(draw), Math.max(0, pauseMs));
}
redraw.atMs = 0;

function draw() {
  pending = false;
  const atMs = (redraw.atMs = performance.now());
  charts.draw(rows, windowS);
  scene.draw(rows, windowS);
  panel.readings(rows, shownNow());
  lastMs = performance.now() - atMs;
  drawn.frames += 1;
  drawn.ms += lastMs;
  drawn.worst = Math.max(drawn.worst, lastMs);
}

const shownNow = () => seen.find(({ vehicle }) => vehicle === shown);

/** @param {string} vehicle */
function see(vehicle) {
  if (vehicle === shown && rows.width) return;
  shown = vehicle;
  history.replaceState(null, "", `#${encodeURIComponent(vehicle)}`);
  live.send({ ask: "see", vehicle });
  showFleet();
}

function showFleet() {
  fleet.show(seen, shown);
  const one = shownNow();
  if (one) {
    panel.show(one);
    orders.emphasise(one.contact === "live" ? one.state ?? "" : "");
  }
  document.title = one ? `${one.vehicle} ${one.contact === "live" ? one.state ?? "" : one.contact} – guidance` : "guidance";
}

/** @type {Record<string, (said: any) => void>} */
const take = {
  welcome(said) {
    if (page && said.page !== page) location.reload(); // another version was installed meanwhile
    page = said.page;
    orders.welcome(said);
  },
  fleet(said) {
    seen = said.fleet;
    orders.heardAtS = said.at_s;
    $("nobody").hidden = seen.length > 0;
    $("fleet").hidden = !seen.length;
    if (seen.length && !shown) see(seen[0].vehicle);
    showFleet();
    events.show(said.notes, shown);
    const live = seen.filter(({ contact }) => contact === "live").length;
    const zenoh = said.trouble ? `zenoh: ${said.trouble}` : said.neighbours ? "" : ", no zenoh neighbour";
    put($("network"), said.trouble ? zenoh : `${live} of ${seen.length} vehicle${seen.length === 1 ? "" : "s"} heard${zenoh}`);
    $("network").classList.toggle("poor", Boolean(zenoh));
    ignored(said.ignored);
  },
  begin(said) {
    rows.begin(said.columns, said.wrap_s, said.rows);
    if (said.vehicle !== scene.vehicle) scene.reset();
    scene.vehicle = said.vehicle;
  },
  about(said) {
    if (said.vehicle !== shown) return;
    panel.detail(said);
    orders.show(said);
    charts.show(said.session?.profile ?? "");
    scene.fence = said.fence;
    scene.origin = said.origin;
    document.body.classList.toggle("fenced", Boolean(said.fence?.corners.length));
  },
  plan(said) {
    if (said.vehicle === shown) scene.plan = said;
  },
  answer: (said) => orders.answered(said),
};

/** What came that is no record of this version. @param {any[]} kinds */
function ignored(kinds) {
  const details = $("ignored");
  details.hidden = !kinds.length;
  const key = JSON.stringify(kinds);
  if (details.dataset.said === key) return;
  details.dataset.said = key;
  const count = kinds.reduce((sum, kind) => sum + kind.count, 0);
  put(details.children[0], `Ignored: ${count} message${count === 1 ? "" : "s"} that this version does not read`);
  details.children[1].replaceChildren(...kinds.map((kind) => make("li", "", `${kind.vehicle}: ${kind.what}, ${kind.count} times (${kind.detail})`)));
}

const live = connect({
  said: (said) => take[said.kind]?.(said),
  rows(came) {
    rows.take(came);
    redraw();
  },
  trouble(text) {
    const alarm = $("alarm");
    document.body.classList.toggle("old", Boolean(text));
    if (alarm.hidden !== !text) alarm.hidden = !text;
    put(alarm, text);
    if (!rows.fresh()) redraw();
  },
  open() {
    if (shown) live.send({ ask: "see", vehicle: shown });
  },
  lost: () => orders.lost(),
});

theme($("theme"), redraw);
handle(scene.camera, $("scene"), $("camera"), redraw);
$("window").addEventListener("click", (/** @type {MouseEvent} */ event) => {
  const chosen = /** @type {HTMLElement} */ (event.target).dataset.window;
  if (!chosen) return;
  windowS = Number(chosen);
  for (const button of $("window").children) button.setAttribute("aria-pressed", String(button.dataset.window === chosen));
  redraw();
});
addEventListener("resize", redraw);
document.addEventListener("visibilitychange", redraw);
