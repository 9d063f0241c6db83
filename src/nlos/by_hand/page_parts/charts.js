// The three charts: the histogram that is looked at, the direct peak in it bin by bin, and the rates of the last minute.
const MARGIN = [58, 10, 34, 10]; // left, right, bottom, top
function field(g, w, h, from, to, most, log, unit) {
  const [left, right, bottom, top] = MARGIN, wide = Math.max(1, w - left - right), high = Math.max(1, h - top - bottom), lift = log ? v => Math.log10(1 + v) : v => v, ceiling = lift(Math.max(most, 1));
  const px = x => left + wide * (x - from) / (to - from || 1), py = v => top + high * (1 - lift(v) / ceiling), [xs, dx] = ticks(from, to, Math.max(3, wide / 80));
  g.textAlign = "center"; g.textBaseline = "top"; g.beginPath();
  for (const x of xs) { g.moveTo(px(x), top + high); g.lineTo(px(x), top + high + 4); g.textAlign = px(x) > w - 24 ? "right" : "center"; g.fillText(fixed(x, dx), Math.min(px(x), w - 1), top + high + 6); }
  g.textAlign = "center"; g.fillText(unit, left + wide / 2, top + high + 20); g.textAlign = "right"; g.textBaseline = "middle";
  for (const v of log ? [0, 1, 10, 100, 1e3, 1e4, 1e5, 1e6, 1e7].filter(v => v <= most) : ticks(0, Math.max(most, 1), Math.max(2, high / 40))[0]) { g.moveTo(left - 4, py(v)); g.lineTo(left + wide, py(v)); g.fillText(v >= 1e6 ? v / 1e6 + " M" : v >= 1e4 ? v / 1e3 + " k" : count(v + 0), left - 7, py(v)); }
  g.stroke(); return {px, py, left, wide, top, high};
}
function bars(canvas, counts, start, bin, from, to, log, mark) {
  const [g, w, h] = pen(canvas), first = Math.max(0, Math.floor((from - start) / bin)), end = Math.min(counts.length, Math.ceil((to - start) / bin)); let most = 0;
  for (let i = first; i < end; i++) most = Math.max(most, counts[i]);
  const {px, py, left, wide, top, high} = field(g, w, h, from, to, most, log, "time after the laser pulse (ns)"), step = wide * bin / (to - from); g.fillStyle = inks.bar;
  if (step >= 1) for (let i = first; i < end; i++) { const y = py(counts[i]); g.fillRect(px(start + i * bin), y, Math.max(1, step), top + high - y); }
  else for (let p = 0; p < wide; p++) { let c = 0; for (let i = first + Math.floor(p / step); i < Math.min(end, first + Math.ceil((p + 1) / step)); i++) c = Math.max(c, counts[i]); const y = py(c); g.fillRect(left + p, y, 1, top + high - y); }
  if (mark === null || mark < from || mark > to) return;
  g.strokeStyle = g.fillStyle = inks.mark; g.setLineDash([3, 3]); g.beginPath(); g.moveTo(px(mark), top); g.lineTo(px(mark), top + high); g.stroke(); g.setLineDash([]);
  g.textAlign = px(mark) > w * .6 ? "right" : "left"; g.textBaseline = "top"; g.fillText(` direct ${mark.toFixed(3)} ns `, px(mark), top);
}
function widthMark(canvas, from, to, at, fwhm) { // a bar as wide as the peak at half its height
  const [left, right, bottom, top] = MARGIN, g = canvas.getContext("2d"), wide = canvas.clientWidth - left - right, px = x => left + wide * (x - from) / (to - from), y = top + (canvas.clientHeight - top - bottom) / 2;
  g.strokeStyle = g.fillStyle = inks.mark; g.lineWidth = 2; g.beginPath(); g.moveTo(px(at - fwhm / 2), y); g.lineTo(px(at + fwhm / 2), y); g.stroke(); g.lineWidth = 1; g.textAlign = "left"; g.textBaseline = "middle"; g.fillText(` ${(1e3 * fwhm).toFixed(0)} ps`, px(at + fwhm / 2), y);
}
function lines(canvas, rows, seconds) { // rows: [seconds ago, detector, direct]
  const [g, w, h] = pen(canvas); let most = 0; for (const r of rows) most = Math.max(most, r[1] || 0, r[2] || 0);
  const {px, py, top} = field(g, w, h, -seconds, 0, most * 1.05, false, "seconds ago");
  [[1, inks.bar, "detector"], [2, inks.mark, "direct peak"]].forEach(([k, ink, name], n) => {
    g.strokeStyle = g.fillStyle = ink; g.lineWidth = 1.6; g.beginPath(); let down = false;
    for (const r of rows) { if (r[k] === null || r[k] === undefined) { down = false; continue; } const x = px(-r[0]), y = py(r[k]); if (down) g.lineTo(x, y); else g.moveTo(x, y); down = true; }
    g.stroke(); g.lineWidth = 1; g.textAlign = "left"; g.textBaseline = "top"; g.fillText(name, MARGIN[0] + 8, top + 2 + 15 * n);
  });
}
