/** Light or dark: as the system says, until somebody switches. */

const NAMES = ["back", "panel", "line", "ink", "soft", "a", "b", "c", "d", "good", "warn", "bad"];

/** The colours in use, for canvases. @type {Record<string, string>} */
export const colours = {};

function read() {
  const style = getComputedStyle(document.documentElement);
  for (const name of NAMES) colours[name] = style.getPropertyValue(`--${name}`).trim();
}

/** Some browsers keep nothing, and say so by an error. @param {() => string|null|void} act */
function perhaps(act) {
  try {
    return act();
  } catch {
    return null;
  }
}

/** @param {HTMLButtonElement} button @param {() => void} changed */
export function theme(button, changed) {
  const root = document.documentElement;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const kept = perhaps(() => localStorage.getItem("theme"));
  if (kept === "light" || kept === "dark") root.dataset.theme = kept;
  const show = () => {
    read();
    changed();
  };
  button.onclick = () => {
    const isDark = root.dataset.theme ? root.dataset.theme === "dark" : dark.matches;
    const chosen = (root.dataset.theme = isDark ? "light" : "dark");
    perhaps(() => localStorage.setItem("theme", chosen));
    show();
  };
  dark.onchange = show;
  read();
}
