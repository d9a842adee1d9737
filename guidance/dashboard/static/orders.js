/**
 * The buttons. Engage and load are asked for once more, here on the page, for the vehicle of the first click;
 * abort, hold and resume go at once. Nothing is kept to be sent later.
 */

import { figure, make, put } from "./words.js";

const $ = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));
const ASKED_MS = 15000;

export class Orders {
  /** @param {(message: object) => boolean} send */
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
    $("orders").addEventListener("click", (event) => {
      const verb = /** @type {HTMLElement} */ (event.target).dataset.verb;
      if (verb) this.#clicked(verb);
    });
    $("confirm-yes").onclick = () => {
      const { asked } = this;
      this.#forget();
      if (asked) this.#order(asked.vehicle, asked.verb, asked.fields);
    };
    $("confirm-no").onclick = () => this.#forget();
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

  /** Another vehicle, or what is known of this one. @param {any} about */
  show(about) {
    if (about.vehicle !== this.vehicle) {
      this.vehicle = about.vehicle;
      this.#forget();
      this.#closeForm();
      put($("answer"), "");
      $("answer").className = "";
    }
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
    else if (verb === "engage") this.#ask(verb, {});
    else {
      this.#forget();
      this.#order(this.vehicle, verb, {});
    }
  }

  /** Ask once more. @param {string} verb @param {any} fields */
  #ask(verb, fields) {
    const { vehicle } = this;
    this.asked = { vehicle, verb, fields };
    const what = verb === "engage" ? `Engage ${vehicle}? It takes control and moves.` : `Load ${fields.trajectory.name} into ${vehicle}?`;
    put($("confirm").children[0], what);
    put($("confirm-yes"), verb === "engage" ? `Engage ${vehicle}` : `Load ${fields.trajectory.name}`);
    $("confirm").hidden = false;
    $("confirm-no").focus();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.#forget(), ASKED_MS);
  }

  #forget() {
    const back = $("confirm").contains(document.activeElement) && this.asked ? $(`order-${this.asked.verb}`) : null;
    this.asked = null;
    clearTimeout(this.timer);
    $("confirm").hidden = true;
    back?.focus();
  }

  /** @param {string} vehicle @param {string} verb @param {object} fields */
  #order(vehicle, verb, fields) {
    const number = ++this.number;
    if (!this.send({ ask: "order", vehicle, verb, number, as_of_s: this.heardAtS, fields })) {
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
    put(answer, text);
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

  #trajectory() {
    /** @type {Record<string, string|number|boolean>} */
    const trajectory = { name: /** @type {HTMLSelectElement} */ ($("load-name")).value };
    for (const input of /** @type {NodeListOf<HTMLInputElement>} */ ($("load").querySelectorAll("input"))) {
      trajectory[input.name] = input.type === "checkbox" ? input.checked : input.valueAsNumber;
    }
    return trajectory;
  }
}
