// The road from above, drawn smoothly between the car's ticks: what is shown is one tick old, and moves.

import { colours } from "./theme.js";

const KEEP = 24;              // frames kept for interpolation
const EGO_AT = 0.32;          // where the ego is, as a share of the width
const BRAKE = -0.5;           // m/s2: from here on the brake lights glow
const EMERGENCY = 5;
const OVERVIEW = 34;          // height of the strip that shows all that is in sight

const lerp = (a, b, k) => a + (b - a) * k;

/** Plays frames at the car's own pace: `at(now)` is the tick to show, about one behind the newest. */
class Playout {
  constructor() { this.frames = []; this.tick = 0; this.rate = 1; this.last = 0; this.came = 0; }

  push(frame, rate, now) {
    const newest = this.frames.at(-1);
    if (newest && newest.epoch === frame.epoch && newest.tick === frame.tick) { this.frames[this.frames.length - 1] = frame; return; }
    if (!newest || newest.epoch !== frame.epoch || frame.tick < newest.tick || frame.tick - this.tick > 45 * Math.max(rate, 1)) {
      this.frames = [];
      this.tick = frame.tick;
    }
    this.frames.push(frame);
    if (this.frames.length > KEEP) this.frames.shift();
    this.rate = rate;
    this.came = now;
  }

  /** [earlier frame, later frame, share of the way] at time `now` in ms; null before the first frame. */
  at(now) {
    const frames = this.frames;
    if (!frames.length) return null;
    const newest = frames.at(-1);
    const dt = Math.min((now - this.last) / 1000, 0.25);
    this.last = now;
    const pace = newest.hz * this.rate;
    const span = frames.length > 1 ? newest.tick - frames.at(-2).tick : 1;
    const since = Math.min((now - this.came) / 1000 * pace, span);
    const goal = newest.tick + since - span - 0.15 * pace / newest.hz;
    this.tick += dt * pace;
    this.tick += (goal - this.tick) * Math.min(1, dt * (this.rate ? 3 : 12));
    this.tick = Math.max(frames[0].tick, Math.min(this.tick, newest.tick));
    let i = frames.length - 1;
    while (i > 0 && frames[i - 1].tick >= this.tick) i--;
    const b = frames[i], a = frames[Math.max(i - 1, 0)];
    return [a, b, b.tick > a.tick ? Math.max(0, (this.tick - a.tick) / (b.tick - a.tick)) : 1];
  }
}

/** Cars at a moment: [{id, x, y, vx, heading, length, width, lane, alpha, braking}], the ego first. */
function between([a, b, k]) {
  const before = new Map(a.cars.map((c) => [c[0], c]));
  const span = Math.max((b.tick - a.tick) / b.hz, 1e-6);
  const cars = b.cars.map((c) => {
    const o = before.get(c[0]);
    before.delete(c[0]);
    const from = o || c;
    return { id: c[0], x: o ? lerp(o[1], c[1], k) : c[1] - c[3] * span * (1 - k), y: lerp(from[2], c[2], k), vx: lerp(from[3], c[3], k),
      heading: lerp(from[5], c[5], k), length: c[6], width: c[7], lane: k < 0.5 ? from[8] : c[8], alpha: o || a === b ? 1 : k,
      braking: o ? (Math.abs(c[3]) - Math.abs(o[3])) / span < -0.8 : false };
  });
  for (const c of before.values()) cars.push({ id: c[0], x: c[1] + c[3] * span * k, y: c[2], vx: c[3], heading: c[5], length: c[6], width: c[7], lane: c[8], alpha: 1 - k, braking: false });
  return cars;
}

export class Road {
  constructor(canvas) {
    this.canvas = canvas;
    this.ctx = canvas.getContext("2d", { alpha: false });
    this.play = new Playout();
    this.road = null;
    this.highlight = null;  // {id, text} of the vehicle that closes an action
    this.blink = 0;
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  resize() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const { clientWidth: w, clientHeight: h } = this.canvas;
    this.w = w; this.h = h;
    this.canvas.width = Math.max(1, Math.round(w * ratio));
    this.canvas.height = Math.max(1, Math.round(h * ratio));
    this.ratio = ratio;
    this.fit();
  }

  setRoad(road) { this.road = road; this.fit(); }

  /** The scale: slow roads are shown nearer; the whole width of the road always fits. */
  fit() {
    if (!this.road || !this.w) return;
    const fast = Math.max(...this.road.lanes.map((l) => l.limit));
    const metres = (50 + 3.2 * fast) * Math.min(1, 0.4 + this.w / 2200);
    const ys = this.road.lanes.flatMap((l, i) => (this.road.shapes[i] ? this.road.shapes[i].filter((p) => p[0] > l.opens - 60).map((p) => p[1]) : [l.y]));
    const top = Math.min(...ys) - 4, bottom = Math.max(...ys) + 4;
    const above = OVERVIEW + 14, below = this.w < 640 ? 122 : 78;  // for the overview and the instruments
    const room = this.h - above - below;
    this.scale = Math.min(this.w / metres, room / (bottom - top));
    this.middle = (top + bottom) / 2;
    this.offset = above + room / 2;
  }

  push(frame, rate) { if (frame.cars) this.play.push(frame, rate, performance.now()); }

  laneY(lane, x) {
    const shape = this.road.shapes[lane];
    if (!shape) return this.road.lanes[lane].y;
    if (x <= shape[0][0]) return shape[0][1];
    for (let i = 1; i < shape.length; i++) {
      if (x <= shape[i][0]) return lerp(shape[i - 1][1], shape[i][1], (x - shape[i - 1][0]) / (shape[i][0] - shape[i - 1][0]));
    }
    return shape.at(-1)[1];
  }

  /** Draw the moment `now` [ms]. Returns what is shown, or null. */
  draw(now) {
    const { ctx, w, h, ratio } = this;
    const c = colours();
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.fillStyle = c.ground;
    ctx.fillRect(0, 0, w, h);
    const moment = this.road ? this.play.at(now) : null;
    if (!moment || moment[1].epoch !== this.road.epoch) {
      ctx.fillStyle = c.muted;
      ctx.font = "15px system-ui, sans-serif";
      ctx.textAlign = "center";
      ctx.fillText("waiting for the car", w / 2, h / 2);
      return null;
    }
    const frame = moment[1];
    const cars = between(moment);
    const ego = cars[0];
    const s = this.scale;
    this.X = (x) => (x - ego.x) * s + w * EGO_AT;
    this.Y = (y) => (y - this.middle) * s + this.offset;
    const left = ego.x - w * EGO_AT / s - 5, right = ego.x + w * (1 - EGO_AT) / s + 5;
    this.blink = Math.floor(now / 360) % 2;
    this.scenery(c, left, right);
    this.lanes(c, left, right, ego, frame);
    this.gap(c, cars, frame);
    this.ghost(c, ego, frame, now);
    for (const car of cars.slice(1).reverse()) this.car(c, car, null);
    this.car(c, ego, frame);
    const plan = frame.directive;
    const marked = this.highlight ?? (plan?.state === "delayed" && plan.vehicle >= 0 ? { id: plan.vehicle, text: plan.reason } : null);
    this.labels(c, cars, marked?.id);
    if (marked) this.mark(c, cars, marked, now);
    this.overview(c, cars, left, right);
    return { frame, cars };
  }

  /** All that the car sees, small, above: the part that is drawn below is framed. */
  overview(c, cars, left, right) {
    const { ctx, road, w } = this;
    const ego = cars[0], sight = road.sight, pad = 14, h = OVERVIEW;
    const X = (x) => w / 2 + (x - ego.x) / sight * (w / 2 - pad);
    const ys = road.lanes.map((l) => l.y);
    const top = Math.min(...ys) - 2, bottom = Math.max(...ys) + 2;
    const Y = (y) => 7 + (y - top) / (bottom - top) * (h - 10);
    ctx.fillStyle = c.card;
    ctx.globalAlpha = 0.75;
    ctx.fillRect(0, 0, w, h + 4);
    ctx.globalAlpha = 1;
    road.lanes.forEach((lane, i) => {
      const from = X(Math.max(ego.x - sight, lane.start)), to = X(Math.min(ego.x + sight, lane.end));
      if (to <= from) return;
      ctx.fillStyle = lane.way < 0 ? c.oncoming : c.muted;
      ctx.globalAlpha = lane.way < 0 ? 0.3 : 0.22;
      ctx.fillRect(from, Y(this.laneY(i, ego.x)) - 1, to - from, 2);
    });
    ctx.globalAlpha = 1;
    for (const car of cars.slice().reverse()) {
      const me = car === ego;
      ctx.fillStyle = me ? c.accent : car.vx < -0.1 ? c.warn : c.ink;
      ctx.globalAlpha = car.alpha * (me ? 1 : 0.8);
      const l = Math.max(6, car.length / sight * (w / 2 - pad));
      ctx.beginPath();
      ctx.roundRect(X(car.x) - l / 2, Y(car.y) - 2, l, 4, 2);
      ctx.fill();
    }
    ctx.globalAlpha = 0.6;
    ctx.strokeStyle = c.muted;
    ctx.lineWidth = 1;
    const a = Math.max(0.5, X(left + 5)), b = Math.min(w - 0.5, X(right - 5));
    ctx.beginPath();
    ctx.roundRect(a, 2.5, b - a, h - 1, 4);
    ctx.stroke();
    ctx.globalAlpha = 1;
    ctx.font = "10px system-ui, sans-serif";
    ctx.textBaseline = "middle";
    for (const [text, x, fits] of [[`−${sight.toFixed(0)} m`, 28, a > 60], [`${sight.toFixed(0)} m`, w - 28, w - b > 60]]) {
      if (!fits) continue;
      ctx.textAlign = "center";
      const wide = ctx.measureText(text).width + 8;
      ctx.fillStyle = c.card;
      ctx.fillRect(x - wide / 2, h / 2 - 5, wide, 13);
      ctx.fillStyle = c.muted;
      ctx.fillText(text, x, h / 2 + 2);
    }
    ctx.textBaseline = "alphabetic";
  }

  /** Posts beside the road, with the distance every 100 m: they show how fast the car is. */
  scenery(c, left, right) {
    const { ctx } = this;
    const edges = this.road.lanes.map((l) => [l.y - l.width / 2, l.y + l.width / 2]).flat();
    const top = Math.min(...edges), bottom = Math.max(...edges, ...this.road.shapes.flatMap((p) => (p ? p.map((q) => q[1] + 2) : [])));
    ctx.fillStyle = c.verge;
    ctx.fillRect(0, this.Y(top - 3), this.w, (bottom - top + 6) * this.scale);
    ctx.font = "10px system-ui, sans-serif";
    ctx.textAlign = "center";
    for (let x = Math.ceil(left / 25) * 25; x < right; x += 25) {
      const major = x % 100 === 0;
      ctx.fillStyle = c.muted;
      ctx.globalAlpha = major ? 0.8 : 0.35;
      ctx.fillRect(this.X(x) - 1, this.Y(top - 1.6), 2, major ? 7 : 4);
      if (major) ctx.fillText(`${x} m`, this.X(x), this.Y(top - 1.6) - 4);
      ctx.globalAlpha = 1;
    }
  }

  band(lane, from, to, side) {
    const plan = this.road.lanes[lane], shape = this.road.shapes[lane];
    const at = (x, off) => [this.X(x), this.Y(this.laneY(lane, x) + off)];
    const xs = shape ? [from, ...shape.map((p) => p[0]).filter((x) => x > from && x < to), to] : [from, to];
    if (side !== undefined) return xs.map((x) => at(x, side * plan.width / 2));
    return [...xs.map((x) => at(x, -plan.width / 2)), ...xs.reverse().map((x) => at(x, plan.width / 2))];
  }

  trace(points, close) {
    const { ctx } = this;
    ctx.beginPath();
    points.forEach(([x, y], i) => (i ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
    if (close) ctx.closePath();
  }

  lanes(c, left, right, ego, frame) {
    const { ctx, road } = this;
    const ends = Math.max(...road.lanes.map((l) => l.end));
    road.lanes.forEach((lane, i) => {
      const from = Math.max(left, lane.start), to = Math.min(right, lane.end);
      if (to <= from) return;
      this.trace(this.band(i, from, to), true);
      ctx.fillStyle = c.asphalt;
      ctx.fill();
      if (lane.way < 0) {
        ctx.globalAlpha = ego.lane === i ? c.borrowed : c.facing;
        ctx.fillStyle = c.oncoming;
        ctx.fill();
        ctx.globalAlpha = 1;
      }
    });
    road.lanes.forEach((lane, i) => {
      const from = Math.max(left, lane.start), to = Math.min(right, lane.end);
      if (to <= from) return;
      this.edges(c, i, from, to);
      this.arrows(c, i, from, to);
      if (lane.end < ends - 1 && lane.end < right) this.barrier(c, i, lane);
    });
    if (ends < right) {
      ctx.fillStyle = c.muted;
      const ys = road.lanes.map((l) => l.y);
      ctx.fillRect(this.X(ends), this.Y(Math.min(...ys) - 2), 3, (Math.max(...ys) - Math.min(...ys) + 4) * this.scale);
    }
    this.limitSigns(c, left, frame);
  }

  /** Solid at the outside and before a ramp opens, dashed between lanes, double towards oncoming traffic. */
  edges(c, i, from, to) {
    const { ctx, road } = this;
    const lane = road.lanes[i], next = road.lanes[i + 1];
    ctx.strokeStyle = c.paint;
    ctx.lineWidth = Math.max(1.2, 0.14 * this.scale);
    const line = (side, a, b, dash, alpha = 0.85) => {
      if (b <= a) return;
      ctx.globalAlpha = alpha;
      ctx.setLineDash(dash ? [3 * this.scale, 6 * this.scale] : []);
      ctx.lineDashOffset = dash ? this.X(Math.floor(a / 9) * 9) < this.X(a) ? (a - Math.floor(a / 9) * 9) * this.scale : 0 : 0;
      this.trace(this.band(i, a, b, side), false);
      ctx.stroke();
    };
    if (i === 0) line(-1, from, to, false);
    if (!next) {
      line(1, from, to, false);
      if (lane.kind === "ramp") line(-1, from, Math.min(to, lane.opens), false);
    } else {
      const beside = next.kind === "ramp" ? [Math.max(from, next.opens), Math.min(to, next.end)] : [Math.max(from, next.start), Math.min(to, next.end)];
      const b = Math.max(beside[0], beside[1]);
      if (lane.way * next.way < 0) {
        ctx.strokeStyle = c.oncoming;
        line(1, from, to, true, 1);
        ctx.strokeStyle = c.paint;
      } else {
        line(1, from, Math.min(to, beside[0]), false);
        line(1, beside[0], Math.min(to, b), true, 0.7);
        line(1, Math.max(from, Math.min(to, b)), to, false);
      }
    }
    ctx.setLineDash([]);
    ctx.globalAlpha = 1;
  }

  arrows(c, i, from, to) {
    const { ctx } = this;
    const lane = this.road.lanes[i];
    const size = Math.min(0.9 * this.scale, 9);
    ctx.globalAlpha = lane.way < 0 ? 0.55 : 0.18;
    ctx.strokeStyle = lane.way < 0 ? c.oncoming : c.paint;
    ctx.lineWidth = 2;
    for (let x = Math.ceil(from / 50) * 50 + 25; x < to; x += 50) {
      const px = this.X(x), py = this.Y(this.laneY(i, x));
      ctx.beginPath();
      ctx.moveTo(px - lane.way * size, py - size);
      ctx.lineTo(px, py);
      ctx.lineTo(px - lane.way * size, py + size);
      ctx.stroke();
    }
    ctx.globalAlpha = 1;
  }

  /** The end of a lane that ends before the road does. */
  barrier(c, i, lane) {
    const { ctx } = this;
    const x = this.X(lane.end), y = this.Y(this.laneY(i, lane.end)), half = lane.width / 2 * this.scale;
    this.trace(this.band(i, Math.max(lane.end - 40, lane.start), lane.end), true);
    const fade = ctx.createLinearGradient(this.X(lane.end - 40), 0, x, 0);
    fade.addColorStop(0, "rgba(224,72,72,0)");
    fade.addColorStop(1, "rgba(224,72,72,.45)");
    ctx.fillStyle = fade;
    ctx.fill();
    for (let k = 0; k < 6; k++) {
      ctx.fillStyle = k % 2 ? "#fff" : "#e04848";
      ctx.fillRect(x - 2, y - half + k * half / 3, 5, half / 3);
    }
  }

  limitSigns(c, left, frame) {
    const { ctx, road } = this;
    if (this.w < 640 || new Set(frame.limits).size < 2) return;
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    road.lanes.forEach((lane, i) => {
      const x = left + 5;
      if (lane.end < x || lane.start > x) return;
      const px = 18, py = this.Y(this.laneY(i, x)), r = Math.min(10, 1.5 * this.scale);
      ctx.beginPath();
      ctx.arc(px, py, r, 0, 7);
      ctx.fillStyle = "#fff";
      ctx.fill();
      ctx.lineWidth = 2;
      ctx.strokeStyle = "#d8433b";
      ctx.stroke();
      ctx.fillStyle = "#16181b";
      ctx.font = `600 ${r > 8 ? 9 : 8}px system-ui, sans-serif`;
      ctx.fillText(Math.round(frame.limits[i] ?? lane.limit), px, py + 0.5);
    });
    ctx.textBaseline = "alphabetic";
  }

  gap(c, cars, frame) {
    const { ctx } = this;
    const near = frame.ahead;
    const lead = near && cars.find((car) => car.id === near.id);
    if (!lead) return;
    const ego = cars[0];
    const a = this.X(ego.x + ego.length / 2), b = this.X(lead.x - lead.length / 2), y = this.Y((ego.y + lead.y) / 2);
    if (b - a < 14) return;
    const colour = near.ttc !== null && near.ttc < 3 ? c.bad : near.ttc !== null && near.ttc < 6 ? c.amber : c.paint;
    ctx.strokeStyle = colour;
    ctx.globalAlpha = 0.6;
    ctx.lineWidth = 1;
    ctx.setLineDash([2, 4]);
    ctx.beginPath();
    ctx.moveTo(a + 4, y);
    ctx.lineTo(b - 4, y);
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.globalAlpha = 1;
    if (b < this.w && b - a > 60) this.pill(c, `${near.gap.toFixed(0)} m`, (a + b) / 2, y, colour === c.paint ? null : colour);
  }

  /** A small label, centred on x or beginning there; kept within the canvas. */
  pill(c, text, x, y, fill, align = "center") {
    const { ctx } = this;
    ctx.font = "600 11px system-ui, sans-serif";
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    const w = ctx.measureText(text).width + 14;
    x = Math.max(w / 2 + 4, Math.min(align === "left" ? x + w / 2 : x, this.w - w / 2 - 4));
    ctx.fillStyle = fill || c.card;
    ctx.globalAlpha = fill ? 1 : 0.85;
    ctx.beginPath();
    ctx.roundRect(x - w / 2, y - 9, w, 18, 9);
    ctx.fill();
    ctx.globalAlpha = 1;
    ctx.fillStyle = fill ? "#1a1000" : c.ink;
    ctx.fillText(text, x, y + 0.5);
    ctx.textBaseline = "alphabetic";
  }

  /** Where the car is going: the lane that it steers for, or else the one that the directive asks for. */
  ghost(c, ego, frame, now) {
    const { ctx, road } = this;
    const plan = frame.directive && !["fulfilled", "expired", "superseded", "cancelled", "failed"].includes(frame.directive.state) ? frame.directive : null;
    const steers = frame.target_lane !== ego.lane || frame.previous_lane >= 0;
    const lane = steers ? frame.target_lane : plan?.lane ?? null;
    if (lane === null || lane === undefined || !road.lanes[lane] || (!steers && lane === ego.lane)) return;
    const waits = !steers && plan?.state === "delayed";
    const ahead = Math.max(14, Math.min(2.6 * Math.max(ego.vx, 3), 55));
    const x = ego.x + ahead, y = this.laneY(lane, x);
    if (Math.abs(y - ego.y) < 0.4) return;
    const x0 = this.X(ego.x + ego.length / 2), y0 = this.Y(ego.y), x1 = this.X(x - ego.length / 2), y1 = this.Y(y);
    const colour = waits ? c.amber : c.accent;
    ctx.strokeStyle = colour;
    ctx.lineWidth = 3;
    ctx.globalAlpha = steers ? 0.9 : 0.6;
    ctx.setLineDash(steers ? [] : [7, 6]);
    ctx.lineDashOffset = waits ? 0 : -now / 40;
    ctx.beginPath();
    ctx.moveTo(x0, y0);
    ctx.bezierCurveTo(lerp(x0, x1, 0.5), y0, lerp(x0, x1, 0.5), y1, x1, y1);
    ctx.stroke();
    const l = ego.length * this.scale, w = ego.width * this.scale;
    ctx.beginPath();
    ctx.roundRect(this.X(x) - l / 2, y1 - w / 2, l, w, w * 0.3);
    ctx.fillStyle = colour;
    ctx.globalAlpha = 0.18;
    ctx.fill();
    ctx.globalAlpha = 0.95;
    ctx.lineWidth = 1.5;
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.globalAlpha = 1;
    if (plan) this.pill(c, waits ? `${plan.manoeuvre}: waits` : plan.manoeuvre, this.X(x) + l / 2 + 8, y1, waits ? c.amber : null, "left");
  }

  /** One car; `frame` is given for the ego. */
  car(c, car, frame) {
    const { ctx } = this;
    const px = this.X(car.x), py = this.Y(car.y);
    if (px < -60 || px > this.w + 60) return;
    const s = this.scale, l = car.length * s, w = car.width * s, ego = frame !== null;
    ctx.save();
    ctx.globalAlpha = car.alpha;
    ctx.translate(px, py);
    ctx.rotate(car.heading);
    if (ego) {
      const beam = ctx.createLinearGradient(l / 2, 0, l / 2 + 9 * s, 0);
      beam.addColorStop(0, c.beam);
      beam.addColorStop(1, "rgba(255,255,255,0)");
      ctx.fillStyle = beam;
      ctx.beginPath();
      ctx.moveTo(l / 2, -w * 0.4); ctx.lineTo(l / 2 + 9 * s, -w); ctx.lineTo(l / 2 + 9 * s, w); ctx.lineTo(l / 2, w * 0.4);
      ctx.fill();
    }
    ctx.fillStyle = c.shadow;
    ctx.beginPath();
    ctx.roundRect(-l / 2 - 1, -w / 2 + 1, l + 2, w + 2, w * 0.35);
    ctx.fill();
    const crashed = ego && frame.crashed;
    ctx.fillStyle = crashed ? c.bad : ego ? c.accent : c.other;
    ctx.beginPath();
    ctx.roundRect(-l / 2, -w / 2, l, w, [w * 0.28, w * 0.42, w * 0.42, w * 0.28]);
    ctx.fill();
    ctx.fillStyle = ego ? c.accentRoof : c.otherRoof;  // glass, then the roof within it
    ctx.beginPath();
    ctx.roundRect(-l * 0.34, -w * 0.4, l * 0.58, w * 0.8, w * 0.2);
    ctx.fill();
    ctx.fillStyle = crashed ? c.bad : ego ? c.accent : c.other;
    ctx.beginPath();
    ctx.roundRect(-l * 0.22, -w * 0.36, l * 0.28, w * 0.72, w * 0.14);
    ctx.fill();
    const lamp = Math.max(2, 0.35 * s);
    ctx.fillStyle = "#fff7d6";
    ctx.fillRect(l / 2 - lamp, -w * 0.42, lamp * 0.8, lamp);
    ctx.fillRect(l / 2 - lamp, w * 0.42 - lamp, lamp * 0.8, lamp);
    const braking = ego ? frame.accel < BRAKE || frame.action?.meta === EMERGENCY : car.braking;
    ctx.fillStyle = braking ? "#ff3b30" : "#8e2a2a";
    if (braking) { ctx.shadowColor = "#ff3b30"; ctx.shadowBlur = 12; }
    ctx.fillRect(-l / 2, -w * 0.44, lamp * 0.8, lamp * 1.3);
    ctx.fillRect(-l / 2, w * 0.44 - lamp * 1.3, lamp * 0.8, lamp * 1.3);
    ctx.shadowColor = "transparent";
    if (ego) {
      const side = turning(frame, car.lane);
      if (side && this.blink) {
        ctx.fillStyle = "#ffb020";
        ctx.shadowColor = "#ffb020";
        ctx.shadowBlur = 14;
        const y = side * (w / 2 - lamp * 0.5) - lamp * 0.7;
        for (const x of [l / 2 - lamp * 2.2, -l / 2 + lamp * 0.4]) {
          ctx.beginPath();
          ctx.roundRect(x, y, lamp * 1.8, lamp * 1.4, 2);
          ctx.fill();
        }
      }
    }
    ctx.restore();
  }

  labels(c, cars, except) {
    const { ctx } = this;
    ctx.font = "600 11px system-ui, sans-serif";
    ctx.textAlign = "center";
    for (const car of cars.slice(1)) {
      const x = this.X(car.x);
      if (x < 12 || x > this.w - 12 || car.id === except) continue;
      ctx.globalAlpha = 0.9 * car.alpha;
      ctx.fillStyle = c.label;
      const above = this.Y(car.y) - car.width * this.scale / 2 - 3;
      ctx.fillText(Math.abs(car.vx).toFixed(0), x, above);
    }
    ctx.globalAlpha = 1;
  }

  /** A ring around the vehicle that is in the way, with the reason. */
  mark(c, cars, { id, text }, now) {
    const car = cars.find((v) => v.id === id);
    if (!car) return;
    const { ctx } = this;
    const x = this.X(car.x), y = this.Y(car.y), l = car.length * this.scale + 10, w = car.width * this.scale + 10;
    ctx.strokeStyle = c.amber;
    ctx.lineWidth = 2.5;
    if (x > 0 && x < this.w) {
      ctx.globalAlpha = 0.75 + 0.25 * Math.sin(now / 160);
      ctx.beginPath();
      ctx.roundRect(x - l / 2, y - w / 2, l, w, w * 0.4);
      ctx.stroke();
      ctx.globalAlpha = 1;
    }
    this.pill(c, x < 0 ? `◀ ${text}` : x > this.w ? `${text} ▶` : text, x, car.y < cars[0].y - 1 ? y - w / 2 - 8 : y + w / 2 + 12, c.amber);
  }
}

/** -1 while a change to the left is under way, 1 to the right, else 0. */
export function turning(frame, lane) {
  if (frame.action?.signal) return frame.action.signal;
  if (frame.previous_lane >= 0) return Math.sign(frame.target_lane - frame.previous_lane);
  return Math.sign(frame.target_lane - lane);
}
