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

/** What is to be seen is asked for again after so long, until rows of it begin. */
const ASK_AGAIN_MS = 1000;

const $ = (/** @type {string} */ id) => /** @type {any} */ (document.getElementById(id));

/** Show the vehicle that the address asks for; a hash that is no name asks for none. */
function seeNamed() {
  const name = location.hash.slice(1);
  if (/^[\w.-]{1,64}$/.test(name)) see(name);
}

const rows = new Rows();
const charts = new Charts($("charts"));
const scene = new Scene($("scene"));
const panel = new VehiclePanel();
const events = new Events($("event-list"), $("events-all"));
const fleet = new FleetTable($("fleet"), chosen);
const orders = new Orders((message, fresh) => live.send(message, fresh));
let windowS = 60;
/** The vehicle that is chosen, and the one whose rows come: not the same while the server has not heard of it. */
let shown = "";
let begun = "";
let askedMs = -Infinity;
/** @type {any[]} */
let seen = [];
/** @type {any[]} */
let notes = [];

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
  apart(() => charts.draw(rows, windowS));
  apart(() => scene.draw(rows, windowS));
  apart(() => panel.readings(rows, shownNow()));
  lastMs = performance.now() - atMs;
  drawn.frames += 1;
  drawn.ms += lastMs;
  drawn.worst = Math.max(drawn.worst, lastMs);
}

/** What fails to be drawn takes nothing else with it; each failure is told once. @param {() => void} part */
function apart(part) {
  try {
    part();
  } catch (error) {
    if (!apart.told.has(String(error))) console.error(error);
    apart.told.add(String(error));
  }
}
apart.told = new Set();

const shownNow = () => seen.find(({ vehicle }) => vehicle === shown);

/** Nothing of another vehicle stays under this one's name. @param {string} vehicle */
function see(vehicle) {
  if (vehicle !== shown) {
    shown = vehicle;
    begun = "";
    history.replaceState(null, "", `#${encodeURIComponent(vehicle)}`);
    orders.turn(vehicle);
    rows.begin(Object.keys(rows.at), rows.wrapS, rows.capacity);
    scene.reset();
    detail({});
    showFleet();
    draw();
  }
  if (begun !== shown) ask();
}

/** On a narrow page the fleet stands above the vehicle. @param {string} vehicle */
function chosen(vehicle) {
  see(vehicle);
  if (matchMedia("(max-width: 75rem)").matches) $("vehicle").scrollIntoView();
}

function ask() {
  askedMs = performance.now();
  live.send({ ask: "see", vehicle: shown });
}

/** @param {any} about what is known in full; empty is nothing */
function detail(about) {
  panel.detail(about);
  scene.fence = about.fence ?? null;
  scene.origin = about.origin ?? null;
  document.body.classList.toggle("fenced", Boolean(about.fence?.corners.length));
}

function showFleet() {
  fleet.show(seen, shown);
  events.show(notes, shown);
  const one = shownNow();
  $("vehicle").hidden = !one;
  $("absent").hidden = Boolean(one) || !seen.length || !shown;
  put($("absent"), `${shown} is not heard. Choose a vehicle of the fleet, or wait for it.`);
  let spoken = "";
  if (one) {
    panel.show(one);
    orders.emphasise(one.contact === "live" ? one.state ?? "" : "");
    spoken = `${one.vehicle} ${one.contact === "live" ? one.state ?? "" : one.contact}`;
  }
  document.title = spoken ? `${spoken} – guidance` : "guidance";
  put($("spoken"), spoken);
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
    notes = said.notes;
    orders.heardAtS = said.at_s;
    $("nobody").hidden = seen.length > 0;
    $("fleet").hidden = !seen.length;
    if (seen.length && !shown) see(seen[0].vehicle);
    if (begun !== shown && performance.now() - askedMs > ASK_AGAIN_MS) ask();
    showFleet();
    const live = seen.filter(({ contact }) => contact === "live").length;
    const zenoh = said.trouble ? `zenoh: ${said.trouble}` : said.neighbours ? "" : ", no zenoh neighbour";
    put($("network"), said.trouble ? zenoh : `${live} of ${seen.length} vehicle${seen.length === 1 ? "" : "s"} heard${zenoh}`);
    $("network").classList.toggle("poor", Boolean(zenoh));
    ignored(said.ignored);
  },
  begin(said) {
    begun = said.vehicle;
    if (begun === shown) rows.begin(said.columns, said.wrap_s, said.rows, said.kept, said.age_s);
  },
  about(said) {
    if (said.vehicle !== shown) return;
    detail(said);
    orders.show(said);
    charts.show(said.asked);
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
    if (begun !== shown) return;
    rows.take(came);
    redraw();
  },
  trouble(text, forS) {
    document.body.classList.toggle("old", Boolean(text));
    if ($("alarm").hidden !== !text) $("alarm").hidden = !text;
    put($("alarm-what"), text);
    put($("alarm-for"), text && `Silent for ${Math.round(forS)} s; the page keeps trying.`);
    if (!rows.fresh()) redraw();
  },
  open() {
    begun = "";
    if (shown) ask();
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
$("skip").onclick = () => $("status").focus();
addEventListener("resize", redraw);
addEventListener("hashchange", seeNamed);
document.addEventListener("visibilitychange", redraw);
seeNamed();
