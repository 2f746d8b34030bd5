// Small helpers. All text goes in as text: nothing that was said or thought is ever taken for markup.

export const $ = (id) => document.getElementById(id);

/** An element with properties and children. */
export function make(tag, props = {}, ...children) {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(props)) {
    if (value === undefined || value === null) continue;
    if (key === "data") Object.assign(node.dataset, value);
    else if (key in node && key !== "role") node[key] = value;
    else node.setAttribute(key, value);
  }
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

/** Set a text only where it changes: layout is not done again for nothing. */
export function text(node, value) {
  if (node.textContent !== value) node.textContent = value;
}

/** Set or remove a data attribute. */
export function mark(node, name, value) {
  if (value === null || value === undefined || value === false) { if (name in node.dataset) delete node.dataset[name]; }
  else if (node.dataset[name] !== String(value)) node.dataset[name] = value;
}

const paths = {
  slower: "M4 8l4 4 4-4", hold: "M3 8h10", faster: "M4 8l4-4 4 4", left: "M13 8H3M7 4 3 8l4 4", right: "M3 8h10M9 4l4 4-4 4", brake: "M8 3v6M8 12.5v.01",
};

export function glyph(name) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 16 16");
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  path.setAttribute("d", paths[name]);
  svg.append(path);
  return svg;
}
