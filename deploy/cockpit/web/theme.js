// Light and dark: as the system has it, until the person chooses. Canvases read the colours here.

const dark = window.matchMedia("(prefers-color-scheme: dark)");
let cache = null;
const listeners = [];

function apply() {
  const chosen = stored();
  document.documentElement.dataset.theme = chosen || (dark.matches ? "dark" : "light");
  cache = null;
  for (const listener of listeners) listener();
}

function stored() {
  try { return localStorage.getItem("theme"); } catch { return null; }
}

export function toggle() {
  const next = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  try { localStorage.setItem("theme", next); } catch { /* a private window: for this visit only */ }
  apply();
  document.documentElement.dataset.theme = next;
  cache = null;
}

export function onTheme(listener) { listeners.push(listener); }

/** The colours of the canvases. */
export function colours() {
  if (cache) return cache;
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(`--${name}`).trim();
  const isDark = document.documentElement.dataset.theme === "dark";
  cache = Object.fromEntries(["page", "card", "edge", "ink", "muted", "accent", "good", "warn", "bad", "ground", "verge", "asphalt", "paint", "oncoming", "other", "shadow"].map((name) => [name, of(name)]));
  cache.otherRoof = of("other-roof");
  cache.accentRoof = isDark ? "#0d3a55" : "#003a66";
  cache.beam = isDark ? "rgba(255,250,220,.28)" : "rgba(255,255,255,.35)";
  cache.amber = "#ffb84d";
  cache.facing = isDark ? 0.15 : 0.3;
  cache.borrowed = isDark ? 0.34 : 0.6;
  cache.label = isDark ? "#d5dee8" : "#ffffff";
  return cache;
}

dark.addEventListener("change", apply);
apply();
