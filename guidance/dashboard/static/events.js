/** What happened, newest first. */

import { clock, make } from "./words.js";

const GLYPHS = { info: "·", notice: "·", warning: "!", error: "✕", critical: "✕" };

export class Events {
  /** @param {HTMLElement} list @param {HTMLInputElement} all */
  constructor(list, all) {
    this.list = list;
    this.all = all;
    this.key = "";
    all.onchange = () => this.show(this.notes ?? [], this.vehicle ?? "");
  }

  /** @param {any[]} notes oldest first @param {string} vehicle */
  show(notes, vehicle) {
    this.notes = notes;
    this.vehicle = vehicle;
    const shown = notes.filter((note) => this.all.checked || note.vehicle === vehicle);
    const key = `${vehicle}/${this.all.checked}/${shown.map((note) => `${note.number}:${note.unix_s}`).join()}`;
    if (key === this.key) return;
    this.key = key;
    const lines = shown.reverse().map((note) => {
      const line = make("li");
      line.dataset.level = note.level;
      line.append(make("time", "", clock(note.unix_s)), make("span", "glyph", GLYPHS[note.level] ?? "·"));
      const text = make("span", "text", this.all.checked ? `${note.vehicle}: ${note.text}` : note.text);
      if (note.level !== "info" && note.level !== "notice") text.prepend(make("b", "", `${note.level} `));
      line.append(text);
      return line;
    });
    this.list.replaceChildren(...(lines.length ? lines : [make("li", "none", "nothing yet")]));
  }
}
