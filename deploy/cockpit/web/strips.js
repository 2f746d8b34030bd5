// Strip charts of the last half minute.

import { colours } from "./theme.js";

const SECONDS = 30;

const CHARTS = [
  { key: "speed", name: "Speed", unit: "m/s", low: 0, high: (d) => Math.max(...d.map((r) => Math.max(r.limit, r.speed))) * 1.12,
    lines: [["limit", "bad", [3, 4]], ["set", "muted", [6, 3]], ["speed", "accent"]], digits: 1 },
  { key: "accel", name: "Acceleration", unit: "m/s²", low: -6, high: () => 4, zero: true, lines: [["accel", "accent"]], digits: 1 },
  { key: "headway", name: "Headway", unit: "s", low: 0, high: () => 6, cap: 6, lines: [["headway", "accent"]], digits: 1 },
  { key: "answered", name: "Answered after", unit: "ms", log: [0.1, 100], lines: [["answered", "good"]], deadline: 20, digits: 2 },
];

export class Strips {
  constructor(parent) {
    this.rows = [];
    this.charts = CHARTS.map((chart) => {
      const row = document.createElement("div");
      row.className = "strip";
      const key = document.createElement("div");
      key.className = "k";
      const value = document.createElement("b");
      value.className = "num";
      value.textContent = "–";
      key.append(chart.name, value);
      const canvas = document.createElement("canvas");
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `${chart.name}, last ${SECONDS} seconds`);
      row.append(key, canvas);
      parent.append(row);
      new ResizeObserver(() => { canvas.width = 0; }).observe(canvas);
      return { ...chart, canvas, value };
    });
  }

  push(frame) {
    if (!frame.cars) return;
    const t = frame.tick / frame.hz;
    const last = this.rows.at(-1);
    if (last && (frame.epoch !== last.epoch || t < last.t)) this.rows = [];
    if (last && frame.epoch === last.epoch && t === last.t) return;
    const lane = frame.cars[0][8];
    this.rows.push({ epoch: frame.epoch, t, speed: frame.cars[0][3], set: frame.set_speed, limit: frame.limits[lane] ?? null, accel: frame.accel,
      headway: frame.ahead?.headway ?? null, answered: frame.action?.answered_ms ?? null });
    while (this.rows.length && this.rows[0].t < t - SECONDS) this.rows.shift();
  }

  draw() {
    const c = colours();
    for (const chart of this.charts) this.chart(c, chart);
  }

  chart(c, chart) {
    const { canvas, value } = chart;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const w = canvas.clientWidth, h = canvas.clientHeight;
    if (!w) return;
    if (canvas.width !== Math.round(w * ratio)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio); }
    const ctx = canvas.getContext("2d");
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    const rows = this.rows;
    const newest = rows.at(-1);
    const now = newest?.[chart.key];
    const text = now === null || now === undefined ? "–" : `${now.toFixed(chart.digits).replace(/^-(0\.?0*)$/, "$1")} ${chart.unit}`;
    if (value.textContent !== text) value.textContent = text;
    if (rows.length < 2) return;
    const [low, high] = chart.log ? chart.log.map(Math.log10) : [chart.low, chart.high(rows)];
    const right = w - 30;
    const X = (t) => right - (newest.t - t) / SECONDS * right;
    const Y = (v) => h - 4 - (Math.min(Math.max(chart.log ? Math.log10(Math.max(v, 1e-3)) : v, low), high) - low) / (high - low) * (h - 10);
    ctx.font = "10px system-ui, sans-serif";
    ctx.textAlign = "left";
    ctx.textBaseline = "middle";
    const rule = (v, label, colour, dash) => {
      ctx.strokeStyle = colour; ctx.lineWidth = 1; ctx.setLineDash(dash || []);
      ctx.beginPath(); ctx.moveTo(0, Y(v)); ctx.lineTo(right, Y(v)); ctx.stroke();
      ctx.setLineDash([]);
      ctx.fillStyle = c.muted;
      ctx.fillText(label, right + 4, Y(v));
    };
    if (chart.zero) rule(0, "0", c.edge);
    if (chart.deadline) { rule(chart.deadline, `${chart.deadline}`, c.bad, [4, 3]); rule(1, "1", c.edge); }
    if (chart.cap) { rule(0, "0", c.edge); rule(2, "2", c.edge); rule(chart.cap, `${chart.cap}`, c.edge); }
    if (chart.key === "speed") rule(0, "0", c.edge);
    for (const [key, colour, dash] of chart.lines) {
      ctx.strokeStyle = c[colour]; ctx.lineWidth = dash ? 1 : 1.75; ctx.setLineDash(dash || []);
      ctx.lineJoin = "round";
      ctx.beginPath();
      let down = false;
      for (const row of rows) {
        const v = row[key];
        if (v === null || v === undefined) { down = false; continue; }
        if (down) ctx.lineTo(X(row.t), Y(v)); else ctx.moveTo(X(row.t), Y(v));
        down = true;
      }
      ctx.stroke();
      ctx.setLineDash([]);
      if (key === "limit" && newest.limit) { ctx.fillStyle = c.muted; ctx.fillText(newest.limit.toFixed(0), right + 4, Y(newest.limit)); }
    }
  }
}
