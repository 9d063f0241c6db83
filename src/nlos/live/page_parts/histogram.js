// The histogram of one point: the one clicked, else the newest; log or linear, with real ticks, time zero and range.
const M_PER_NS = .299792458 / 2; // range of a nanosecond there and back: c t / 2
const RANGE = "range from the wall point, c t / 2 (m)";
const histogram = {
  pinned: null, log: true, counts: null, shown: null, zero: null, masked: null,
  place() {
    const known = scans[chosen]; if (!known || !known.plan || !known.state.samples) return null;
    if (this.pinned !== null) return this.pinned;
    return placeOf(known, known.state.samples - 1);
  },
  forget() { this.pinned = this.counts = this.shown = null; },
  async ask() {
    const at = this.place(), known = scans[chosen]; if (at === null) return; const got = await ask(`histogram?scan=${chosen}&place=${at}`); if (!got.counts || known !== scans[chosen]) return;
    this.counts = unpacked(got.counts); this.shown = at; this.zero = got.zero_ns; this.masked = got.masked_ns; this.draw();
  },
  draw() {
    const [g, w, h] = pen($("histo")), known = scans[chosen]; if (!this.counts || !known.plan) return;
    const {start, bin, window: gate} = known.plan, n = this.counts.length, [left, right, bottom] = [58, 8, 34], top = this.zero === null ? 8 : 48, wide = w - left - right, high = h - bottom - top;
    let peak = 0, sum = 0, where = 0; this.counts.forEach((c, i) => { sum += c; if (c > peak) { peak = c; where = i; } });
    const lift = this.log ? v => Math.log10(1 + v) : v => v, most = lift(Math.max(peak, 1)), px = ns => left + wide * (ns - start) / (n * bin), py = v => top + high * (1 - lift(v) / most);
    if (gate) { g.fillStyle = inks.line; g.fillRect(px(start + gate[0] * bin), top, wide * (gate[1] - gate[0]) / n, high); }
    this.axes(g, {left, top, wide, high, px, py, peak, end: start + n * bin, start, bin});
    g.fillStyle = inks.bar; const step = wide / n;
    if (step >= 1) this.counts.forEach((c, i) => { const t = py(c); g.fillRect(left + i * step, t, Math.max(1, step), top + high - t); });
    else for (let p = 0; p < wide; p++) { let c = 0; for (let i = Math.floor(p / step); i < Math.min(n, Math.ceil((p + 1) / step)); i++) c = Math.max(c, this.counts[i]); const t = py(c); g.fillRect(left + p, t, 1, top + high - t); }
    this.marks(g, {left, top, wide, high, px, end: start + n * bin, start, w, highest: peak > 4 ? start + (where + .5) * bin : null});
    this.tell(sum, peak);
  },
  axes(g, {left, top, wide, high, px, py, peak, start, end, bin}) {
    g.fillStyle = inks.dim; g.textAlign = "center"; g.textBaseline = "top"; g.beginPath();
    const [xs, dx] = ticks(start, end, Math.max(3, wide / 60)); for (const v of xs) { g.moveTo(px(v), top + high); g.lineTo(px(v), top + high + 4); g.fillText(fixed(v, dx), px(v), top + high + 6); }
    g.fillText("time after the laser pulse (ns)", left + wide / 2, top + high + 20);
    g.save(); g.translate(9, top + high / 2); g.rotate(-Math.PI / 2); g.textBaseline = "middle"; g.fillText(`counts in ${(1e3 * bin).toFixed(0)} ps`, 0, 0); g.restore();
    g.textAlign = "right"; g.textBaseline = "middle";
    const ys = this.log ? this.decades(peak, py) : ticks(0, peak || 1, 4)[0];
    for (const v of ys) { g.moveTo(left - 4, py(v)); g.lineTo(left + wide, py(v)); g.fillText(v >= 1e4 ? v.toExponential(0) : count(v), left - 7, py(v)); }
    g.strokeStyle = inks.grid; g.stroke();
  },
  decades(peak, py) { // 0, 1, 10, ... up to the peak; 5, 50, ... and 2, 20, ... where there is room
    const powers = [...Array(10).keys()].map(k => 10 ** k), out = [0, ...powers.filter(v => v <= peak)];
    for (const times of [5, 2]) for (const v of powers.map(p => times * p)) if (v <= peak && out.every(u => Math.abs(py(u) - py(v)) > 13)) out.push(v);
    return out;
  },
  // Above: the range from this wall point, c t / 2 after the arrival of direct light: a slanted way, no depth. Before a
  // picture knows that arrival, the highest bin alone is marked.
  marks(g, {left, top, wide, high, px, start, end, w, highest}) {
    const at = this.zero === null ? highest : this.zero; if (at === null) return;
    g.textBaseline = "bottom"; g.fillStyle = inks.dim; g.strokeStyle = inks.dim;
    if (this.zero !== null && at < end) {
      const [ranges, digits] = ticks(0, (end - at) * M_PER_NS, Math.max(2, (left + wide - px(at)) / 40)); g.beginPath(); g.moveTo(px(at), top); g.lineTo(left + wide, top); g.textAlign = "center";
      for (const r of ranges) { const x = px(at + r / M_PER_NS); g.moveTo(x, top); g.lineTo(x, top - 4); if (r && x < left + wide - 6) g.fillText(fixed(r, digits), x, top - 5); }
      g.stroke(); g.textAlign = "right"; g.fillText(RANGE, left + wide, top - 18);
      g.fillStyle = inks.mark; g.globalAlpha = .25; g.fillRect(px(at), top, Math.max(1, px(at + this.masked) - px(at)), high); g.globalAlpha = 1;
    }
    if (at < start || at > end) return;
    g.strokeStyle = g.fillStyle = inks.mark; g.setLineDash([3, 3]); g.beginPath(); g.moveTo(px(at), top - (this.zero === null ? 0 : 6)); g.lineTo(px(at), top + high); g.stroke(); g.setLineDash([]);
    if (this.zero === null) { g.textAlign = px(at) > w * .6 ? "right" : "left"; g.textBaseline = "top"; g.fillText(` highest bin ${at.toFixed(2)} ns `, px(at), top); }
    else { const text = `time zero ${at.toFixed(2)} ns`, half = g.measureText(text).width / 2; g.textAlign = "center"; g.fillText(text, Math.min(Math.max(px(at), half), left + wide - half), top - 33); }
  },
  tell(sum, peak) {
    const {x, y, window: gate} = scans[chosen].plan;
    $("histotitle").textContent = `Histogram at x ${x[this.shown].toFixed(3)}, y ${y[this.shown].toFixed(3)} m ${this.pinned === null ? scans[chosen].state.status === "running" && !gone ? "(newest point)" : "(last point taken)" : "(kept; Esc lets go)"}`;
    $("histosay").textContent = `${count(sum)} counts, ${count(peak)} in the highest bin` + (this.masked ? `; the wall's own light (${(1e3 * this.masked).toFixed(0)} ps) left out` : "") + (gate ? "; grey: the window that ends a point" : "");
    $("scale").lastElementChild.textContent = this.log ? "log" : "linear";
  },
};
$("scale").addEventListener("click", () => { histogram.log = !histogram.log; histogram.draw(); });
