// The page: connection, clock of the picture, keyboard.

import { $, mark, text } from "./dom.js";
import { Panels } from "./panels.js";
import { Road } from "./road.js";
import { Strips } from "./strips.js";
import { Talk } from "./talk.js";
import { toggle } from "./theme.js";

const road = new Road($("road"));
const panels = new Panels(road);
const strips = new Strips($("strips"));
const talk = new Talk(say);
let socket = null;
let session = "";
let source = { kind: "live", can: [] };
let frame = null;
let stale = false;
let wait = 250;
let bannerUntil = 0;
let chosen = false;  // another road, seed or density stands in the form, and is not ordered yet

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.onmessage = (event) => receive(JSON.parse(event.data));
  socket.onopen = () => { wait = 250; };
  socket.onclose = () => {
    link("lost", "no connection");
    setTimeout(connect, wait);
    wait = Math.min(wait * 2, 4000);
  };
}

function send(ask) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(ask));
}

function receive(message) {
  if (message.refused) { refused(message.refused); return; }
  send({ seen: 1 });
  if (message.session !== session) { session = message.session; talk.clear(); strips.rows = []; }
  source = message.source;
  if (message.road) {
    road.setRoad(message.road);
    text($("scenario"), message.road.scenario);
    $("scenario").hidden = false;
  }
  for (const note of message.notes) {
    talk.note(note);
    if (note.what === "world" && message.frame.t - note.t < 5) banner("info", note.detail || "new world", 4000);
  }
  frame = message.frame;
  const rate = source.paused ? 0 : source.speed ?? 1;
  road.push(frame, rate);
  strips.push(frame);
  stale = true;
  showSource();
}

function showSource() {
  const can = new Set(source.can);
  const silent = !frame.cars || (source.kind === "live" && frame.age > 1);
  if (source.paused) link("paused", "paused");
  else if (silent) link("waiting", frame.cars ? "the simulator is silent" : "waiting for the car");
  else link(source.kind === "replay" ? "replay" : "live", source.kind === "replay" ? `replay ${source.speed}×` : "live");
  $("transport").hidden = !can.has("pause");
  $("step").hidden = !can.has("step");
  $("step").disabled = !source.paused;
  $("restart").hidden = !can.has("restart");
  $("rate").hidden = !can.has("speed");
  mark($("pause"), "paused", source.paused ? "" : null);
  $("pause").setAttribute("aria-label", source.paused ? "Go on" : "Pause");
  $("scrub").hidden = !can.has("seek");
  $("say").hidden = $("more").hidden = !can.has("say");
  if (can.has("seek")) {
    const seek = $("seek");
    seek.max = source.length;
    if (document.activeElement !== seek || !seek.matches(":active")) seek.value = source.position;
    text($("position"), `${source.position.toFixed(1)} / ${source.length.toFixed(1)} s`);
    if (document.activeElement !== $("speed")) $("speed").value = String(source.speed);
  }
  showWorld();
}

/** Road, seed and density; the form has them, too, until somebody chooses others. */
function showWorld() {
  const { seed, density } = frame;
  text($("traffic"), seed === undefined ? "" : `seed ${seed}${density === 1 ? "" : ` · density ${+density.toFixed(2)}×`}`);
  if (chosen || !source.scenarios?.length || !road.road || seed === undefined) return;
  const now = road.road.scenario, choice = $("road-choice");
  const own = source.scenarios.includes(now) ? [] : [new Option(now, "")];  // a road from a file: "" keeps it
  const names = [...own.map((one) => one.text), ...source.scenarios];
  if (names.join() !== [...choice.options].map((one) => one.text).join()) {
    choice.replaceChildren(...own, ...source.scenarios.map((name) => new Option(name, name)));
  }
  choice.value = own.length ? "" : now;
  if ($("seed").value !== String(seed)) $("seed").value = seed;
  if (Number($("density").value) !== density) $("density").value = density;
}

function link(is, words) {
  mark($("link"), "is", is);
  text($("link"), words);
}

function banner(is, words, ms) {
  mark($("banner"), "is", is);
  text($("banner"), words);
  $("banner").hidden = false;
  bannerUntil = performance.now() + ms;
}

function draw(now) {
  const shown = road.draw(now);
  if (stale && frame) {
    stale = false;
    panels.update(frame, road.road);
    strips.draw();
    if (frame.cars) text($("clock"), `tick ${frame.tick} · ${(frame.tick / frame.hz).toFixed(1)} s`);
  }
  if (shown) standing(shown, now);
  requestAnimationFrame(draw);
}

/** What must be seen at once: a crash, a borrowed lane. Else the last short notice, while it lasts. */
function standing({ frame: seen, cars }, now) {
  if (seen.crashed) banner("bad", "collision", 300);
  else if (road.road.lanes[cars[0].lane]?.way < 0 && now > bannerUntil - 200) banner("warn", "borrowed lane: traffic comes towards us", 300);
  if (now > bannerUntil) $("banner").hidden = true;
}

/** For who cannot see the canvas: the situation in words, every few seconds. */
function describe() {
  if (!frame?.cars) return;
  const ego = frame.cars[0];
  const lead = frame.ahead ? `car ahead at ${frame.ahead.gap.toFixed(0)} metres` : "nobody ahead";
  $("road").setAttribute("aria-label", `The road from above: lane ${ego[8]} of ${frame.limits.length}, ${ego[3].toFixed(0)} metres per second, ${lead}, ${frame.cars.length - 1} cars in sight`);
}

function say(words) {
  $("refused").hidden = true;
  if (socket?.readyState !== WebSocket.OPEN) { refused("There is no connection to the car."); return; }
  send({ say: words });
}

function refused(why) {
  text($("refused"), why);
  $("refused").hidden = false;
  setTimeout(() => { $("refused").hidden = true; }, 6000);
  if ($("say").hidden || $("talk").hidden) banner("warn", why, 4000);
}

function tab(name, focus) {
  for (const id of ["talk", "thoughts", "log"]) {
    const chosen = id === name;
    $(id).hidden = !chosen;
    $(`tab-${id}`).setAttribute("aria-selected", chosen);
    $(`tab-${id}`).tabIndex = chosen ? 0 : -1;
    if (chosen && focus) $(`tab-${id}`).focus();
  }
  if (name === "talk") $("bubbles").scrollTop = $("bubbles").scrollHeight;
}

const TABS = ["talk", "thoughts", "log"];
for (const name of TABS) {
  $(`tab-${name}`).addEventListener("click", () => tab(name));
  $(`tab-${name}`).addEventListener("keydown", (event) => {
    const move = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (move) tab(TABS[(TABS.indexOf(name) + move + 3) % 3], true);
  });
}

const pause = () => send({ do: source.paused ? "resume" : "pause" });
$("pause").addEventListener("click", pause);
$("step").addEventListener("click", () => send({ do: "step" }));
$("speed").addEventListener("change", () => send({ do: "speed", value: Number($("speed").value) }));
let sought = 0;
$("seek").addEventListener("input", () => {
  const goal = Number($("seek").value);  // now: the next frame moves the slider to where the playhead is
  clearTimeout(sought);
  sought = setTimeout(() => send({ do: "seek", value: goal }), 120);
});
$("restart").addEventListener("input", () => { chosen = true; });
$("restart").addEventListener("submit", (event) => {
  event.preventDefault();
  chosen = false;
  send({ do: "restart", value: { scenario: $("road-choice").value, seed: Number($("seed").value), density: Number($("density").value) } });
});
$("say").addEventListener("submit", (event) => {
  event.preventDefault();
  const words = $("words").value.trim();
  if (words) say(words);
  $("words").value = "";
});
$("theme").addEventListener("click", () => { toggle(); strips.draw(); });
$("help").addEventListener("click", () => $("keys").showModal());

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || $("keys").open) return;
  const typing = event.target.matches("input, select, textarea");
  if (event.key === "Escape" && typing) event.target.blur();
  if (typing) return;
  const button = event.target.matches("button, summary");
  if (event.key === "/") { event.preventDefault(); tab("talk"); $("words").focus(); }
  else if (event.key === " " && !button && !$("transport").hidden) { event.preventDefault(); pause(); }
  else if (event.key === "." && !$("step").disabled) send({ do: "step" });
  else if (event.key === "t") $("theme").click();
  else if (event.key === "?") $("keys").showModal();
  else if (["1", "2", "3"].includes(event.key)) tab(TABS[Number(event.key) - 1], true);
});

$("more").open = window.innerHeight >= 820 && window.innerWidth > 640;
setInterval(describe, 2000);
connect();
requestAnimationFrame(draw);
