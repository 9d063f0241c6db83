// The count map at the side: counts per second at every point taken, and the point whose histogram is shown.
const map = {
  draw() {
    const known = scans[chosen], [g, w, h] = pen($("map")); this.frame = null; if (!known || !known.plan) return;
    const {x, y, grid, wall} = known.plan, rates = known.rates; this.frame = wallFrame(g, w, h, wall, [52, 6, 84, 36]); if (!rates) { axes(g, this.frame, wall); return; }
    const [, high] = quantiles(rates, .02, .98), top = high || 1, colour = v => Number.isFinite(v) ? viridis(v / top) : inks.emptyRgb;
    if (grid) image(g, rates, grid[0], grid[1], this.frame.box, colour);
    else { g.fillStyle = inks.empty; g.fillRect(...this.frame.box); const size = Math.max(3, this.frame.scale * known.pitch * .8);
      for (let i = 0; i < x.length; i++) if (Number.isFinite(rates[i])) { const [px, py] = this.frame.at(x[i], y[i]); g.fillStyle = `rgb(${colour(rates[i]).map(Math.round)})`; g.fillRect(px - size / 2, py - size / 2, size, size); } }
    axes(g, this.frame, wall); const at = histogram.place(), [bx, by, bw, bh] = this.frame.box, [unit, word] = top >= 2e6 ? [1e6, "million"] : top >= 2e3 ? [1e3, "thousand"] : [1, ""]; $("maprange").textContent = scans.length > 1 ? known.state.run : "";
    colourBar(g, bx + bw + 10, by, bh, 0, top / unit, viridis, word + " counts/s");
    if (at !== null) { const [px, py] = this.frame.at(x[at], y[at]); g.save(); g.beginPath(); g.rect(bx, by, bw, bh); g.clip(); g.strokeStyle = "#000"; g.lineWidth = 3.5; g.beginPath(); g.arc(px, py, 6, 0, 7); g.stroke(); g.strokeStyle = "#fff"; g.lineWidth = 1.8; g.stroke(); g.restore(); }
  },
};
function nearest(known, x, y) {
  let best = -1, least = Infinity; const p = known.plan;
  for (let i = 0; i < p.x.length; i++) { const d = (p.x[i] - x) ** 2 + (p.y[i] - y) ** 2; if (d < least) { least = d; best = i; } }
  return best;
}
function pinAt(scan, x, y) { const known = scans[scan]; if (known.plan) { chosen = scan; histogram.pinned = nearest(known, x, y); histogram.ask(); map.draw(); } }
$("map").addEventListener("click", e => { if (map.frame) pinAt(chosen, ...map.frame.metres(e.offsetX, e.offsetY)); });
const asides = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};
// The point to that side of one: the nearest where a step across counts thrice, so that a row is kept to.
function aside({x, y}, from, [right, up]) {
  let best = from, least = Infinity;
  for (let i = 0; i < x.length; i++) {
    const dx = x[i] - x[from], dy = y[i] - y[from], along = dx * right + dy * up, across = Math.abs(dx * up) + Math.abs(dy * right);
    if (along > 1e-9 && along + 3 * across < least) { least = along + 3 * across; best = i; }
  }
  return best;
}
function ratesAt(known, i) { return `x ${known.plan.x[i].toFixed(3)} m, y ${known.plan.y[i].toFixed(3)} m: ` + (known.rates && Number.isFinite(known.rates[i]) ? rate(known.rates[i]) : "not measured yet"); }
$("map").addEventListener("keydown", e => {
  const known = scans[chosen], side = asides[e.key], from = histogram.place(); if (!side || !known || !known.plan || from === null || e.ctrlKey || e.metaKey || e.altKey) return;
  e.preventDefault(); e.stopPropagation(); histogram.pinned = aside(known.plan, from, side); histogram.ask(); map.draw(); $("mapsay").textContent = ratesAt(known, histogram.pinned);
});
$("map").addEventListener("pointermove", e => {
  const known = scans[chosen]; if (!map.frame || !known.rates) return; const i = nearest(known, ...map.frame.metres(e.offsetX, e.offsetY));
  $("mapsay").textContent = ratesAt(known, i);
});
$("map").addEventListener("pointerleave", () => { $("mapsay").textContent = "click a point, or go there by arrow keys, to keep its histogram"; });
