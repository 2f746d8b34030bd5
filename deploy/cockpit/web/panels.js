// The instruments beside the road: speed, gaps, actions, directive, processes.

import { $, glyph, make, mark, text } from "./dom.js";

const ACTIONS = [["slower", "Slower"], ["hold", "Hold"], ["faster", "Faster"], ["left", "Left"], ["right", "Right"]];
const SHOWN = [2, 1, 0, 3, 4];
const SOURCES = {
  policy: ["Policy", "The learnt policy chose this action."],
  masked: ["Mask", "The safety mask closed what the policy preferred."],
  coordination: ["Coordination", "The passenger's wish decided against the policy's preference."],
  fallback: ["Fallback", "The policy failed; a simple rule drives."],
};
const TAKEN_MS = 700;
const HOLD = 1;
const OVER = ["fulfilled", "expired", "superseded", "cancelled", "failed"];

/** Where a vehicle is, in words: " · 42 m ahead". */
function where(frame, id) {
  const car = id >= 0 ? frame.cars.find((row) => row[0] === id) : undefined;
  if (!car) return "";
  const along = car[1] - frame.cars[0][1];
  return ` · ${Math.abs(along).toFixed(0)} m ${along < 0 ? "behind" : "ahead"}`;
}

export class Panels {
  constructor(road) {
    this.road = road;
    this.taken = new Map();
    this.rows = new Map();
    for (const index of SHOWN) {
      const [icon, name] = ACTIONS[index];
      const bar = make("i");
      const note = make("span", { className: "note num" });
      const label = make("span", { className: "name", textContent: name });
      const row = make("li", {}, glyph(icon), label, make("span", { className: "p" }, bar), note);
      const show = () => { if (row.vehicle >= 0) road.highlight = { id: row.vehicle, text: row.reason }; };
      const hide = () => { road.highlight = null; };
      row.addEventListener("pointerenter", show);
      row.addEventListener("focus", show);
      row.addEventListener("pointerleave", hide);
      row.addEventListener("blur", hide);
      $("actions").append(row);
      this.rows.set(index, { row, bar, note });
    }
    this.nodes = new Map();
  }

  update(frame, road) {
    this.health(frame.nodes || []);
    if (!frame.cars) return;
    const ego = frame.cars[0];
    text($("v"), Math.max(ego[3], 0).toFixed(1));
    text($("kmh"), `${(3.6 * Math.max(ego[3], 0)).toFixed(0)} km/h`);
    text($("vset"), frame.set_speed.toFixed(1));
    text($("vlimit"), (frame.limits[ego[8]] ?? 0).toFixed(0));
    const trend = (n, faster, slower) => (n.ttc !== null ? `TTC ${n.ttc.toFixed(0)} s` : Math.abs(n.speed - ego[3]) < 0.5 ? "same speed" : n.speed > ego[3] ? faster : slower);
    this.tile("ahead", frame.ahead, (n) => `${n.headway === null ? "" : `${n.headway.toFixed(1)} s · `}${trend(n, "pulls away", "closing")}`);
    this.tile("behind", frame.behind, (n) => trend(n, "closing", "falls back"));
    const two = road?.lanes.some((lane) => lane.way < 0);
    $("t-oncoming").hidden = !two;
    this.tile("oncoming", frame.oncoming, (n) => (n.ttc === null ? "" : `meet in ${n.ttc.toFixed(0)} s`));
    this.actions(frame);
    this.directive(frame);
  }

  tile(name, near, words) {
    const tile = $(`t-${name}`);
    text(tile.querySelector("b"), near ? `${Math.max(near.gap, 0).toFixed(0)} m` : "free");
    text(tile.querySelector("span"), near ? words(near) : "");
    const ttc = near?.ttc ?? null;
    mark(tile, "level", name !== "oncoming" && ttc !== null && ttc < 6 ? (ttc < 3 ? "bad" : "warn") : null);
  }

  actions(frame) {
    const action = frame.action;
    if (!action) return;
    const now = performance.now();
    if (action.tick !== this.lastTick) { this.taken.set(action.meta, now); this.lastTick = action.tick; }
    const closed = new Map(action.closed.map(([a, reason, vehicle]) => [a, { reason, vehicle }]));
    const lately = (index) => now - (this.taken.get(index) ?? -1e9) < TAKEN_MS;
    const moved = SHOWN.some((index) => index !== HOLD && lately(index));
    for (const [index, { row, bar, note }] of this.rows) {
      const by = closed.get(index);
      const p = action.p[index];
      row.reason = by?.reason ?? "";
      row.vehicle = by?.vehicle ?? -1;
      mark(row, "closed", by ? "" : null);
      mark(row, "taken", lately(index) && (index !== HOLD || !moved) ? "" : null);
      bar.style.transform = `scaleX(${p ?? 0})`;
      bar.parentElement.hidden = p === undefined;
      text(note, by ? `${by.reason}${where(frame, by.vehicle)}` : p === undefined ? "open" : `${(100 * p).toFixed(0)} %`);
      if (by && by.vehicle >= 0) row.tabIndex = 0; else row.removeAttribute("tabindex");
    }
    const [name, why] = SOURCES[action.source] || [action.source, ""];
    const braking = action.meta === 5;
    text($("source"), braking ? "Emergency brake" : name);
    const held = action.meta === HOLD && action.source === "policy" && action.p.some((p) => p > (action.p[HOLD] ?? 1));
    text($("why"), action.why || (held ? "The set-points hold until the policy's next decision." : why));
    mark($("source"), "is", braking ? "fallback" : action.source);
  }

  directive(frame) {
    const d = frame.directive;
    const state = d?.state ?? (frame.waits_for ? "waiting" : null);
    text($("d-state"), state ?? "none");
    mark($("d-state"), "is", state);
    $("d-next").hidden = !frame.waits_for || !d;
    text($("d-next"), frame.waits_for ? `The next step waits for ${frame.waits_for}.` : "");
    const box = $("directive");
    if (!d) {
      const words = frame.waits_for ? `Understood. The first step waits for ${frame.waits_for}.` : frame.wished ? "Nothing is under way. What was wished for stands until another wish replaces it." : "Nothing is wished. The car chooses its lane and drives as usual.";
      if (box.dataset.id !== words) { box.replaceChildren(make("p", { className: "empty", textContent: words })); box.dataset.id = words; }
      return;
    }
    if (box.dataset.id !== String(d.id)) {
      box.dataset.id = d.id;
      box.replaceChildren(
        make("div", { className: "wish" }, make("b"), make("span", { className: "muted" })),
        make("div", { className: "ttl", role: "progressbar", "aria-label": "Life of the directive", "aria-valuemin": 0, "aria-valuemax": d.ttl }, make("i")),
        make("p", { className: "wait", hidden: true, tabIndex: 0 }),
        make("ol", { className: "steps" }),
        make("p", { className: "reason" }),
      );
      const wait = box.querySelector(".wait");
      const show = () => { if (wait.vehicle >= 0) this.road.highlight = { id: wait.vehicle, text: wait.reason }; };
      wait.onpointerenter = wait.onfocus = show;
      wait.onpointerleave = wait.onblur = () => { this.road.highlight = null; };
    }
    const parts = [];
    if (d.lane !== null) parts.push(`lane ${d.lane}`);
    if (d.speed !== null) parts.push(`${d.speed.toFixed(0)} m/s`);
    if (d.headway !== null) parts.push(`${d.headway.toFixed(1)} s gap`);
    if (d.style !== "normal") parts.push(d.style);
    text(box.querySelector(".wish b"), d.manoeuvre);
    text(box.querySelector(".wish span"), [...parts, OVER.includes(d.state) ? "" : `${d.left.toFixed(0)} s left`].filter(Boolean).join(" · "));
    const bar = box.querySelector(".ttl");
    bar.setAttribute("aria-valuenow", d.left.toFixed(0));
    bar.firstChild.style.transform = `scaleX(${Math.min(1, d.left / d.ttl)})`;
    text(box.querySelector(".reason"), d.reasoning);
    const wait = box.querySelector(".wait");
    const delayed = d.state === "delayed";
    wait.hidden = !delayed;
    wait.vehicle = d.vehicle;
    wait.reason = d.reason;
    if (delayed) text(wait, `waits ${d.waited.toFixed(0)} s: ${d.reason}${where(frame, d.vehicle)}${d.detail ? ` · ${d.detail}` : ""}`);
    this.steps(frame, d, box);
  }

  /** How far it has come: never back within one command. */
  steps(frame, d, box) {
    const passes = d.manoeuvre === "overtake";
    const borrowed = this.road.road?.lanes[frame.cars[0][8]]?.way < 0;
    const over = OVER.includes(d.state);
    const last = passes ? 4 : d.lane === null ? 2 : 3;
    let stage = over ? last : passes && borrowed ? 3 : frame.previous_lane >= 0 && last > 2 ? 2 : 1;
    if (this.stage?.command === d.command_id && this.stage.last === last) stage = Math.max(stage, this.stage.at);
    this.stage = { command: d.command_id, at: stage, last };
    const waits = d.state === "delayed";
    const names = passes ? ["understood", "prepares", "moves out", "passes", "done"] : d.lane === null ? ["understood", "adjusts", "done"] : ["understood", "prepares", "changes", "done"];
    if (over) names[last] = d.state;
    else if (waits) names[stage] = "waits";
    const list = box.querySelector(".steps");
    while (list.children.length > names.length) list.lastChild.remove();
    while (list.children.length < names.length) list.append(make("li"));
    names.forEach((name, i) => {
      const item = list.children[i];
      text(item, name);
      mark(item, "is", i < stage ? "done" : i > stage ? null : over && d.state !== "fulfilled" ? "bad" : waits ? "now" : "done");
    });
  }

  health(nodes) {
    for (const node of nodes) {
      let item = this.nodes.get(node.node);
      if (!item) {
        item = make("li", {}, make("i", { "aria-hidden": "true" }), make("b", { textContent: node.node }), make("small", { className: "num" }));
        this.nodes.set(node.node, item);
        $("nodes").append(item);
      }
      mark(item, "state", node.state);
      text(item.querySelector("small"), node.state === "gone" ? `silent for ${node.age.toFixed(0)} s` : `${node.state} · ${(Math.max(node.age, 0) * 1000).toFixed(0)} ms`);
      item.title = `process ${node.pid}${node.detail ? `: ${node.detail}` : ""}\n${Object.entries(node.metrics).map(([k, v]) => `${k} ${v}`).join("\n")}`;
    }
    const sim = nodes.find((node) => node.node === "sim");
    if (sim && sim.metrics.age_p99_us !== undefined) {
      const f = sim.metrics;
      const mode = sim.mode && sim.mode !== "NOMINAL" ? `${sim.mode}: ${sim.mode_why} · ` : "";
      text($("ticks"), `${mode}age of the action ${(f.age_p50_us / 1000).toFixed(1)} / ${(f.age_p99_us / 1000).toFixed(1)} ms · missed ${f.missed ?? 0}${f.refused || f.strays ? ` · actuator refused ${(f.refused ?? 0) + (f.strays ?? 0)}` : ""}`);
      $("ticks").title = "From what the car saw until it did what answers that: median and 99th percentile, as the simulator measures it";
    }
  }
}
