/**
 * The buttons; each names its vehicle. What moves it is asked for once more, here on the page, for the vehicle of
 * the first click; abort and hold go at once. Nothing is kept to be sent later.
 */

import { clock, figure, make, put } from "./words.js";

const $ = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));
const ASKED_MS = 15000;
/** An answer is news for so long. */
const NEWS_MS = 30000;
/** What moves a vehicle, and what is asked before. @type {Record<string, (vehicle: string, fields: any) => string>} */
const MOVING = {
  engage: (vehicle) => `Engage ${vehicle}? It takes control and moves.`,
  resume: (vehicle) => `Resume ${vehicle}? It moves on along its path.`,
  load: (vehicle, { trajectory }) => `Load ${trajectory.name} into ${vehicle}?`,
};

export class Orders {
  /** @param {(message: object, fresh: boolean) => boolean} send */
  constructor(send) {
    this.send = send;
    this.vehicle = "";
    this.allowed = false;
    this.number = 0;
    /** The server's clock when it was last heard. */
    this.heardAtS = 0;
    /** @type {Map<number, {vehicle: string, verb: string}>} */
    this.waiting = new Map();
    /** @type {any[]} */
    this.trajectories = [];
    /** @type {{vehicle: string, verb: string, fields: object}|null} */
    this.asked = null;
    this.timer = 0;
    this.fading = 0;
    $("orders").addEventListener("click", (event) => {
      const button = /** @type {HTMLElement} */ (event.target).closest("button");
      if (button?.dataset.verb) this.#clicked(button.dataset.verb);
    });
    $("confirm-yes").onclick = () => {
      const { asked } = this;
      this.#forget();
      if (asked) this.#order(asked.vehicle, asked.verb, asked.fields);
    };
    $("confirm-no").onclick = () => this.#forget();
    document.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.#forget();
    });
    // What was asked about is no longer what the form says.
    $("load").addEventListener("input", () => this.#forget());
    $("load").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#ask("load", { trajectory: this.#trajectory() });
    });
  }

  /** What the server allows. @param {any} said */
  welcome(said) {
    this.allowed = said.commands;
    this.trajectories = said.trajectories;
  }

  /** Another vehicle is shown: no buttons until it is known whether it takes orders. @param {string} vehicle */
  turn(vehicle) {
    this.#forget();
    this.#closeForm();
    this.vehicle = vehicle;
    this.current = {};
    $("orders").hidden = $("no-orders").hidden = true;
    for (const whom of $("orders").querySelectorAll(".whom")) put(whom, vehicle);
    clearTimeout(this.fading);
    put($("answer"), "");
    $("answer").className = "";
  }

  /** What is known of the vehicle. @param {any} about */
  show(about) {
    if (about.vehicle !== this.vehicle) return;
    const on = this.allowed && about.commands;
    $("orders").hidden = !on;
    if (!on) {
      this.#forget();
      this.#closeForm();
    }
    $("no-orders").hidden = on;
    put($("no-orders"), this.allowed
      ? `No buttons: ${about.vehicle} takes no orders by zenoh (zenoh.commands in its configuration).`
      : "For looking only: orders need the dashboard started with --commands.");
    this.current = about.trajectory ?? {};
  }

  /** @param {string} state the buttons that lead on are plain to see */
  emphasise(state) {
    const next = { engage: ["ready", "handed-over", "aborted"], hold: ["tracking"], resume: ["holding"] };
    for (const [verb, states] of Object.entries(next)) $(`order-${verb}`).classList.toggle("next", states.includes(state));
  }

  /** @param {any} said */
  answered(said) {
    if (!this.waiting.delete(said.number)) return;
    const outcome = said.accepted === null ? "no answer" : said.accepted ? "accepted" : "refused";
    this.#say(`${said.vehicle}: ${said.verb} ${outcome}${said.reason ? `: ${said.reason}` : ""}`, outcome);
  }

  /** The connection is gone, and the answers with it. */
  lost() {
    if (!this.waiting.size) return;
    const verbs = [...this.waiting.values()].map(({ vehicle, verb }) => `${vehicle}: ${verb}`).join(", ");
    this.waiting.clear();
    this.#say(`${verbs}: the connection was lost before the answer; look at the state`, "no answer");
  }

  /** @param {string} verb */
  #clicked(verb) {
    if (verb === "load") this.#toggleForm();
    else if (verb in MOVING) this.#ask(verb, {});
    else {
      this.#forget();
      this.#order(this.vehicle, verb, {});
    }
  }

  /** Ask once more. @param {string} verb @param {any} fields */
  #ask(verb, fields) {
    const { vehicle } = this;
    this.asked = { vehicle, verb, fields };
    put($("confirm-question"), MOVING[verb](vehicle, fields));
    $("confirm-values").replaceChildren(...(verb === "load" ? this.#filledIn() : []));
    put($("confirm-yes"), `${verb[0].toUpperCase()}${verb.slice(1)} ${verb === "load" ? fields.trajectory.name : vehicle}`);
    $("confirm").hidden = false;
    $("confirm-no").focus();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.#forget(), ASKED_MS);
  }

  #forget() {
    if (!this.asked) return;
    const back = $("confirm").contains(document.activeElement) ? $(`order-${this.asked.verb}`) : null;
    this.asked = null;
    clearTimeout(this.timer);
    $("confirm").hidden = true;
    back?.focus();
  }

  /** @param {string} vehicle @param {string} verb @param {object} fields */
  #order(vehicle, verb, fields) {
    const number = ++this.number;
    if (!this.send({ ask: "order", vehicle, verb, number, as_of_s: this.heardAtS, fields }, verb in MOVING)) {
      this.#say(`${vehicle}: ${verb} was NOT sent: no connection to the dashboard's server`, "refused");
      return;
    }
    this.waiting.set(number, { vehicle, verb });
    if (verb === "load") this.#closeForm();
    this.#say(`${vehicle}: ${verb} …`, "waiting");
  }

  /** @param {string} text @param {string} outcome */
  #say(text, outcome) {
    const answer = $("answer");
    answer.className = outcome.replace(" ", "-");
    put(answer, `${clock(Date.now() / 1000)} ${text}`);
    clearTimeout(this.fading);
    if (outcome !== "waiting") this.fading = setTimeout(() => { answer.className = ""; }, NEWS_MS);
  }

  #toggleForm() {
    if (!$("load").hidden) {
      this.#closeForm();
      return;
    }
    $("load").hidden = false;
    $("order-load").setAttribute("aria-expanded", "true");
    this.#fillForm(this.trajectories.find((one) => one.name === this.current?.name) ?? this.trajectories[0]);
    $("load-name").focus();
  }

  #closeForm() {
    $("load").hidden = true;
    $("order-load").setAttribute("aria-expanded", "false");
  }

  /** @param {any} shape */
  #fillForm(shape) {
    const select = /** @type {HTMLSelectElement} */ (make("select"));
    select.id = "load-name";
    for (const { name } of this.trajectories) select.add(new Option(name, name, false, name === shape.name));
    select.onchange = () => {
      this.#fillForm(this.trajectories.find((one) => one.name === select.value));
      $("load-name").focus();
    };
    const label = make("label", "", "Trajectory");
    label.append(select);
    const inputs = shape.keys.map((/** @type {any} */ key) => {
      const input = /** @type {HTMLInputElement} */ (make("input"));
      const value = this.current?.name === shape.name ? this.current[key.key] ?? key.default : key.default;
      input.name = key.key;
      input.type = key.yes_or_no ? "checkbox" : "number";
      if (key.yes_or_no) input.checked = Boolean(value);
      else Object.assign(input, { step: "any", min: String(key.least), max: String(key.most), value: String(value), required: true });
      const field = make("label", "", key.about || key.key);
      field.title = key.yes_or_no ? key.key : `${key.key}, ${figure(key.least, 2)} to ${figure(key.most, 0)}`;
      field.append(input);
      return field;
    });
    const submit = /** @type {HTMLButtonElement} */ (make("button", "", "Load…"));
    submit.type = "submit";
    $("load").replaceChildren(label, ...inputs, submit);
  }

  /** The form's values, each with its words. */
  #filledIn() {
    const inputs = /** @type {NodeListOf<HTMLInputElement>} */ ($("load").querySelectorAll("input"));
    return [...inputs].map((input) => {
      const item = make("li", "", `${input.parentElement?.textContent}: `);
      item.append(make("b", "", input.type === "checkbox" ? (input.checked ? "yes" : "no") : String(input.valueAsNumber)));
      return item;
    });
  }

  #trajectory() {
    /** @type {Record<string, string|number|boolean>} */
    const trajectory = { name: /** @type {HTMLSelectElement} */ ($("load-name")).value };
    for (const input of /** @type {NodeListOf<HTMLInputElement>} */ ($("load").querySelectorAll("input"))) {
      trajectory[input.name] = input.type === "checkbox" ? input.checked : input.valueAsNumber;
    }
    return trajectory;
  }
}
