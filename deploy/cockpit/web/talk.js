// What was said, thought and has happened.

import { $, make, mark } from "./dom.js";

const KEPT = 300;
const EXAMPLES = [
  "I'm in a hurry to get to work, I want to drive faster", "Overtake the car in front of us", "Please slow down a little", "Keep more distance to the car ahead",
  "Go to the right lane", "Drive at 18 metres per second", "Stay behind this car", "Forget it, drive normally", "Please stop", "Fahr bitte etwas schneller",
];
const BAD = ["refused", "failed", "expired"];

export class Talk {
  constructor(say) {
    this.commands = new Map();
    for (const words of EXAMPLES) {
      const button = make("button", { type: "button", textContent: words });
      button.addEventListener("click", () => { say(words); });
      $("examples").append(button);
    }
    this.clear();
  }

  clear() {
    this.commands.clear();
    mark($("more"), "slim", null);
    $("bubbles").replaceChildren(make("p", { className: "empty", textContent: "Say what you would like, in your own words. The car answers here." }));
    $("events").replaceChildren();
    $("thoughts").replaceChildren(make("p", { className: "empty", textContent: "For each command: what the slow part read, recalled and answered, and what was changed. Say something first." }));
  }

  note(note) {
    if (note.kind === "command") this.command(note);
    else if (note.kind === "reply") this.reply(note);
    else if (note.kind === "thought") this.thought(note);
    if (note.kind !== "thought") this.event(note);
  }

  add(list, node) {
    list.querySelector(":scope > .empty")?.remove();
    const near = list.scrollHeight - list.scrollTop - list.clientHeight < 60;
    list.append(node);
    while (list.children.length > KEPT) list.firstChild.remove();
    if (near) list.scrollTop = list.scrollHeight;
  }

  command(note) {
    mark($("more"), "slim", "");  // one line of examples: from now on the conversation has the room
    const bubble = make("div", { className: "said", textContent: note.text });
    this.commands.set(note.id, { text: note.text, t: note.t });
    this.add($("bubbles"), bubble);
  }

  reply(note) {
    if (note.outcome === "heard" && !note.waits_for) return;
    const command = this.commands.get(note.command_id);
    const small = make("small", {}, make("span", { className: "tag", textContent: note.waits_for ? "waiting" : note.outcome, data: { is: note.waits_for ? "waiting" : BAD.includes(note.outcome) ? "failed" : note.outcome === "fulfilled" ? "fulfilled" : "policy" } }));
    if (command) small.append(`${Math.max(note.t - command.t, 0).toFixed(1)} s later `);
    if (note.why) small.append(`· ${note.why} `);
    if (note.verdict) small.append(make("span", { className: "tag", textContent: `language model: ${note.verdict}`, data: { is: note.verdict === "overruled" || note.verdict === "withdrew" ? "failed" : "policy" } }), " ");
    const link = make("button", { type: "button", textContent: "thought", hidden: !document.getElementById(`thought-${note.command_id}`) });
    link.dataset.thought = note.command_id;
    link.addEventListener("click", () => this.openThought(note.command_id));
    small.append(link);
    this.add($("bubbles"), make("div", { className: "heard" }, note.say ? make("p", { textContent: note.say }) : null, small));
  }

  openThought(id) {
    $("tab-thoughts").click();
    const thought = document.getElementById(`thought-${id}`);
    if (thought) { thought.open = true; thought.scrollIntoView({ block: "start" }); }
  }

  event(note) {
    const [name, words] = wording(note);
    const row = make("li", { data: { kind: name } }, make("time", { textContent: note.t.toFixed(1) }), make("b", { textContent: name }), make("span", { textContent: words }));
    $("events").prepend(row);
    while ($("events").children.length > KEPT) $("events").lastChild.remove();
  }

  thought(note) {
    const list = $("thoughts");
    list.querySelector(":scope > .empty")?.remove();
    list.prepend(thoughtOf(note, list.children.length === 0));
    while (list.children.length > 30) list.lastChild.remove();
    for (const link of document.querySelectorAll("[data-thought]")) if (link.dataset.thought === String(note.command_id)) link.hidden = false;
  }
}

function wording(note) {
  const car = note.vehicle >= 0 && note.vehicle !== undefined ? `car ${note.vehicle}` : "";
  const list = (...parts) => parts.filter(Boolean).join(" · ");
  switch (note.kind) {
    case "command": return ["said", `“${note.text}” (${note.source})`];
    case "reply": return [note.outcome, list(note.say, note.why, note.verdict && `language model: ${note.verdict}`)];
    case "directive": return ["directive", list(note.manoeuvre, note.target_lane !== undefined ? `lane ${note.target_lane}` : "", note.target_speed_mps !== undefined ? `${note.target_speed_mps.toFixed(1)} m/s` : "", note.headway_s !== undefined ? `${note.headway_s.toFixed(1)} s gap` : "", note.reasoning)];
    case "health": return [note.state, `process ${note.node}`];
    default: return [note.what, list(note.reason, car, note.duration_s ? `for ${note.duration_s.toFixed(1)} s` : "", note.detail)];
  }
}

function section(title, ...nodes) {
  return make("section", {}, make("h3", { textContent: title }), ...nodes);
}

/** Every exchange with the language model: what failed, what it thought, its raw answer. A message has the newest of each. */
function triesOf(note, pre) {
  const wrong = (words) => make("p", { className: "guard", textContent: words });
  const answers = [...note.answers];
  let left = note.tries.filter((one) => !one.failed).length;
  const sections = note.tries.map((one) => {
    const parts = [];
    if (one.failed) parts.push(wrong(one.failed));
    if (one.thinking) parts.push(make("details", {}, make("summary", { textContent: "What it thought" }), pre(one.thinking)));
    if (!one.failed && left-- <= answers.length) parts.push(pre(answers.shift()));
    if (one.unusable) parts.push(wrong(`Not usable: ${one.unusable}`));
    return section(`${note.model}, asked for ${one.asked}: ${one.ms.toFixed(0)} ms`, ...parts);
  });
  return [...sections, ...answers.map((answer) => section("Raw answer", pre(answer)))];
}

/** A thought as a folded card: who decided, then everything that led to it. */
function thoughtOf(note, open) {
  const spans = Object.entries(note.spans_ms).filter(([, ms]) => ms > 0);
  const total = spans.reduce((sum, [, ms]) => sum + ms, 0);
  const bar = make("div", { className: "spans", "aria-hidden": "true" }, ...spans.map(([, ms]) => { const i = make("i"); i.style.flexGrow = ms; return i; }));
  const legend = make("div", { className: "legend num" }, ...spans.map(([name, ms]) => make("span", { textContent: `${name} ${ms.toFixed(ms < 10 ? 1 : 0)} ms` })),
    note.prompt_tokens ? make("span", { textContent: `${note.prompt_tokens} tokens in, ${note.answer_tokens} out` }) : null,
    note.cost_usd ? make("span", { textContent: `${note.cost_usd.toFixed(5)} USD` }) : null);
  const pre = (words) => make("pre", { textContent: words });
  const none = (words) => make("p", { className: "empty", textContent: words });
  const body = make("div", {});
  if (spans.length) body.append(section("Time", bar, legend));
  if (note.again) body.append(section("Asked once more", pre(note.again)));
  if (note.reading) body.append(section("The intent parser understood", pre(note.reading)));
  if (note.recalled.length) {
    body.append(section("Recalled, with its similarity", ...note.recalled.map((m) => make("div", { className: "memory num" }, make("b", { textContent: m.similarity.toFixed(2) }), make("span", { textContent: `“${m.command}”` }), make("small", { textContent: [m.slots, m.outcome].filter(Boolean).join(" · ") })))));
  }
  for (const message of note.prompt) body.append(section(`Prompt: ${message.role}`, pre(message.content)));
  body.append(...triesOf(note, pre));
  if (!note.tries.length && !note.answers.length) body.append(section("Raw answer", none("The language model was not asked.")));
  body.append(section("What the guards changed", note.guards.length ? make("ul", {}, ...note.guards.map((g) => make("li", { className: "guard", textContent: g }))) : none("Nothing.")));
  if (note.slots) body.append(section("Taken as", pre(note.slots)));
  return make("details", { className: "thought", id: `thought-${note.command_id}`, open },
    make("summary", {}, make("q", { textContent: note.command }), make("span", { className: "tag", textContent: note.outcome, data: { is: note.outcome === "issued" ? "fulfilled" : "failed" } }),
      make("small", { className: "num", textContent: `${note.t.toFixed(1)} s · by ${note.source || "nobody"}${note.verdict ? ` · language model: ${note.verdict}` : ""}${total ? ` · ${total.toFixed(0)} ms` : ""}${note.trimmed ? " · shortened" : ""}` })), body);
}
