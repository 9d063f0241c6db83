// The histogram of one point: the one clicked, else the newest; log or linear, with real ticks.
const histogram = {
  pinned: null, log: true, counts: null, shown: null,
  place() {
    const known = scans[chosen]; if (!known || !known.plan || !known.state.samples) return null;
    if (this.pinned !== null) return this.pinned;
    return known.plan.order[Math.min(known.state.samples, known.plan.order.length) - 1];
  },
  async ask() {
    const at = this.place(); if (at === null) return; const got = await ask(`histogram?scan=${chosen}&place=${at}`); if (!got.counts) return;
    this.counts = unpacked(got.counts); this.shown = at; this.draw();
  },
  draw() {
    const [g, w, h] = pen($("histo")), known = scans[chosen]; if (!this.counts || !known.plan) return;
    const {start, bin, x, y, window: gate} = known.plan, n = this.counts.length, [left, right, bottom, top] = [58, 6, 34, 8], wide = w - left - right, high = h - bottom - top;
    let peak = 0, sum = 0, where = 0; this.counts.forEach((c, i) => { sum += c; if (c > peak) { peak = c; where = i; } });
    const lift = this.log ? v => Math.log10(1 + v) : v => v, most = lift(Math.max(peak, 1)), px = ns => left + wide * (ns - start) / (n * bin), py = v => top + high * (1 - lift(v) / most);
    if (gate) { g.fillStyle = inks.line; g.fillRect(px(start + gate[0] * bin), top, wide * (gate[1] - gate[0]) / n, high); }
    g.fillStyle = inks.dim; g.textAlign = "center"; g.textBaseline = "top"; g.beginPath();
    const [xs, dx] = ticks(start, start + n * bin, Math.max(3, wide / 60)); for (const v of xs) { g.moveTo(px(v), top + high); g.lineTo(px(v), top + high + 4); g.fillText(fixed(v, dx), px(v), top + high + 6); }
    g.fillText("time after the laser pulse (ns)", left + wide / 2, top + high + 20); g.save(); g.translate(9, top + high / 2); g.rotate(-Math.PI / 2); g.textBaseline = "middle"; g.fillText(`counts in ${(1e3 * bin).toFixed(0)} ps`, 0, 0); g.restore(); g.textAlign = "right"; g.textBaseline = "middle";
    const ys = this.log ? [0, 1, 10, 100, 1e3, 1e4, 1e5, 1e6].filter(v => v <= peak) : ticks(0, peak || 1, 4)[0];
    for (const v of ys) { g.moveTo(left - 4, py(v)); g.lineTo(left + wide, py(v)); g.fillText(v >= 1e4 ? v.toExponential(0) : count(v), left - 7, py(v)); }
    g.strokeStyle = inks.grid; g.stroke(); g.fillStyle = inks.bar; const step = wide / n;
    if (step >= 1) this.counts.forEach((c, i) => { const t = py(c); g.fillRect(left + i * step, t, Math.max(1, step), top + high - t); });
    else for (let p = 0; p < wide; p++) { let c = 0; for (let i = Math.floor(p / step); i < Math.min(n, Math.ceil((p + 1) / step)); i++) c = Math.max(c, this.counts[i]); const t = py(c); g.fillRect(left + p, t, 1, top + high - t); }
    const direct = start + (where + .5) * bin;
    if (peak > 4) { g.strokeStyle = inks.mark; g.setLineDash([3, 3]); g.beginPath(); g.moveTo(px(direct), top); g.lineTo(px(direct), top + high); g.stroke(); g.setLineDash([]);
      g.fillStyle = inks.mark; g.textAlign = px(direct) > w * .6 ? "right" : "left"; g.textBaseline = "top"; g.fillText(` highest bin ${direct.toFixed(2)} ns `, px(direct), top); }
    $("histotitle").textContent = `Histogram at x ${x[this.shown].toFixed(3)}, y ${y[this.shown].toFixed(3)} m ${this.pinned === null ? "(newest point)" : "(kept; Esc lets go)"}`;
    $("histosay").textContent = `${count(sum)} counts, ${count(peak)} in the highest bin` + (gate ? "; shaded: the window that ends a point" : ""); $("scale").lastElementChild.textContent = this.log ? "log" : "linear";
  },
};
$("scale").addEventListener("click", () => { histogram.log = !histogram.log; histogram.draw(); });
