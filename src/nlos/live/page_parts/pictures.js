// The panels with pictures: front view, depth, difference; axes, colour bar, value under the cursor, scan points.
const FAINT = FAINT_AT, FULL = FULL_AT, DOUBTFUL = DOUBTFUL_AT, SURE = SURE_AT, SETTLED = STABLE_AT; // depth has no colour below FAINT of the brightest point, and its full colour from FULL on; what is less likely a surface than DOUBTFUL is hatched
const PAPER = [224, 224, 224]; // as in depth.png: the far end of the colours is dark, and to be told from nothing
const TRAILS = ["#4cc9f0", "#80ed99", "#f15bb5", "#ffffff"]; // as in film.gif
const fade = a => a < FAINT ? 0 : Math.min(1, .1 + .9 * (a - FAINT) / (FULL - FAINT));
function depthSpan(pictures) {
  const seen = [];
  for (const p of pictures) if (p && p.depth_m) for (let i = 0; i < p.depth_m.length; i++) if (p.albedo[i] >= .1 && Number.isFinite(p.depth_m[i])) seen.push(p.depth_m[i]);
  let [low, high] = quantiles(seen, .02, .98); const pad = Math.max(.02, .05 * (high - low)); return [Math.max(0, low - pad), high + pad];
}
const doubted = (p, i) => !!p.seen && p.seen[i] < DOUBTFUL && p.albedo[i] > FAINT;
// Thin strokes as far apart on every grid, a little lighter than what is dark and a little darker than what is bright: doubt is seen, and what is drawn is seen through it.
const HATCH_PX = 7, HATCH_LIGHT = "rgba(255, 255, 255, .42)", HATCH_DARK = "rgba(0, 0, 0, .42)", HATCH_TURNS = .4;
const hatch = (g, p, rows, cols, box) => strokes(g, rows, cols, box, i => doubted(p, i) && p.albedo[i] < HATCH_TURNS, i => doubted(p, i) && p.albedo[i] >= HATCH_TURNS);
function strokes(g, rows, cols, [bx, by, bw, bh], light, dark) { // over these pixels; whether there are any
  let any = false; const pw = bw / cols, ph = bh / rows;
  for (const [ink, here] of [[HATCH_LIGHT, light], [HATCH_DARK, dark]]) {
    g.save(); g.beginPath(); let some = false;
    for (let i = 0; i < rows * cols; i++) if (here(i)) { some = true; g.rect(bx + (i % cols) * pw, by + Math.floor(i / cols) * ph, pw, ph); }
    if (some) { any = true; g.clip(); g.strokeStyle = ink; g.lineWidth = 1; g.beginPath(); for (let x = bx - bh; x < bx + bw; x += HATCH_PX) { g.moveTo(x, by + bh); g.lineTo(x + bh, by); } g.stroke(); }
    g.restore();
  }
  return any;
}
// Both ends of a difference are as dark: to who sees no colours, what is below zero is hatched.
const BELOW = -.1, FAR_BELOW = -.6;
const hatchBelow = (g, rows, cols, box, part) => strokes(g, rows, cols, box, i => part(i) < FAR_BELOW, i => part(i) < BELOW && part(i) >= FAR_BELOW);
const NEITHER = [150, 150, 150]; // where one of two pictures has no depth; no colour of a difference is that grey
function onGrid(p, rows, cols) { // every pixel of a finer grid takes what the picture has at its centre
  const [r, c] = p.albedo.shape; if (r === rows && c === cols) return p;
  const taken = values => { if (!values) return values; const out = new Float32Array(rows * cols); out.shape = [rows, cols];
    for (let i = 0; i < out.length; i++) { const row = Math.floor((Math.floor(i / cols) + .5) * r / rows), col = Math.floor((i % cols + .5) * c / cols); out[i] = values[row * c + col]; } return out; };
  return {...p, albedo: taken(p.albedo), depth_m: taken(p.depth_m), seen: taken(p.seen)};
}
const inkOf = (p, i) => Number.isFinite(p.depth_m[i]) ? fade(p.albedo[i]) * (p.seen ? p.seen[i] : 1) : 0;
function deeperSpan(one, other) { // alike to both sides, wide enough for all but a fiftieth
  const off = []; for (let i = 0; i < one.depth_m.length; i++) if (inkOf(one, i) > .3 && inkOf(other, i) > .3) off.push(Math.abs(one.depth_m[i] - other.depth_m[i]));
  const most = Math.max(.01, off.length ? quantiles(off, .98)[0] : 0); return [-most, most];
}
function speedWords(v, error) { // the error is that along the way
  const speed = Math.hypot(...v), off = speed ? Math.hypot(...v.map((c, k) => c * error[k])) / speed : Math.hypot(...error);
  return error.every(c => c !== null) ? `${speed.toFixed(2)} ± ${off.toFixed(2)} m/s` : `${speed.toFixed(2)} m/s`;
}
// The near end of the colours is as light as the paper: to who sees no colours, a line is where what is seen ends.
function outline(g, p, rows, cols, [bx, by, bw, bh]) {
  const pw = bw / cols, ph = bh / rows, seen = (r, c) => r >= 0 && r < rows && c >= 0 && c < cols && inkOf(p, r * cols + c) >= .5;
  g.strokeStyle = "rgba(0, 0, 0, .7)"; g.lineWidth = 1; g.beginPath();
  for (let r = 0; r <= rows; r++) for (let c = 0; c <= cols; c++) {
    const here = seen(r, c), x = bx + c * pw, y = by + r * ph;
    if (here !== seen(r - 1, c)) { g.moveTo(x, y); g.lineTo(x + pw, y); }
    if (here !== seen(r, c - 1)) { g.moveTo(x, y); g.lineTo(x, y + ph); }
  }
  g.stroke();
}
function inWords(p) { // the figures of a picture, to who cannot see it
  const {albedo, depth_m: depth, wall} = p, [rows, cols] = albedo.shape; let top = 0, low = Infinity, high = -Infinity, number = 0;
  albedo.forEach((v, i) => { if (v > albedo[top]) top = i; if (inkOf(p, i)) { number++; low = Math.min(low, depth[i]); high = Math.max(high, depth[i]); } });
  const x = ((top % cols + .5) / cols - .5) * wall[0], y = (.5 - (Math.floor(top / cols) + .5) / rows) * wall[1];
  return `brightest at x ${x.toFixed(2)} m, y ${y.toFixed(2)} m; ` + (number ? `surfaces from ${low.toFixed(2)} to ${high.toFixed(2)} m from the wall in ${(100 * number / albedo.length).toFixed(0)} % of the picture` : "no surface is seen");
}
function named(panel, role) { // to who cannot see it: called as the heading over it, with what stands under it
  panel.canvas.setAttribute("role", role); panel.title.id = panel.canvas.id + "-title"; panel.say.id = panel.canvas.id + "-say";
  panel.canvas.setAttribute("aria-labelledby", panel.title.id); panel.canvas.setAttribute("aria-describedby", panel.say.id);
}
class PicturePanel {
  constructor(kind, scan) {
    this.kind = kind; this.scan = scan; this.box = document.createElement("section"); this.box.className = "panel"; this.box.dataset.kind = kind;
    this.title = document.createElement("h2"); this.canvas = document.createElement("canvas"); this.canvas.id = panelName(kind, scan); this.say = document.createElement("p"); this.say.className = "say";
    named(this, "application"); this.canvas.tabIndex = 0; this.empty = document.createElement("div"); this.empty.className = "empty"; this.box.append(this.title, this.canvas, this.say, this.empty);
    this.canvas.addEventListener("pointermove", e => { this.keyed = false; this.cursor = [e.offsetX, e.offsetY]; this.readOut(); });
    this.canvas.addEventListener("keydown", e => this.step(e)); this.canvas.addEventListener("blur", () => { if (this.keyed) this.keep(null); });
    this.canvas.addEventListener("pointerleave", () => { this.cursor = null; this.readOut(); });
    this.canvas.addEventListener("click", e => { if (this.frame) pinAt(this.scan, ...this.frame.metres(e.offsetX, e.offsetY)); });
  }
  draw(picture, limits, other) {
    this.picture = picture; const [g, w, h] = pen(this.canvas); this.empty.hidden = !!picture; if (!picture) { this.frame = null; return; }
    const wall = picture.wall, [rows, cols] = picture.albedo.shape, tall = Math.min((w - 64) / wall[0], (h - 112) / wall[1]) > Math.min((w - 148) / wall[0], (h - 46) / wall[1]), margin = tall ? [56, 8, 16, 96] : [56, 8, 92, 38]; this.frame = wallFrame(g, w, h, wall, margin); this.limits = limits;
    const [bx, by, bw, bh] = this.frame.box, [low, high] = limits, e = PAPER; g.save();
    let hatched = false;
    if (this.kind === "front") { image(g, picture.albedo, rows, cols, this.frame.box, gray); hatched = hatch(g, picture, rows, cols, this.frame.box); }
    else if (this.kind === "depth") image(g, picture.depth_m, rows, cols, this.frame.box, (v, i) => {
      const k = inkOf(picture, i), c = k ? viridis(1 - (v - low) / (high - low || 1)) : e; return c.map((x, j) => e[j] + (x - e[j]) * k); });
    else if (this.kind === "deeper") { image(g, picture.depth_m, rows, cols, this.frame.box, (v, i) => {
      const k = Math.min(inkOf(picture, i), inkOf(other, i)), c = k ? redBlue(.5 + .5 * (v - other.depth_m[i]) / high) : NEITHER; return c.map((x, j) => NEITHER[j] + (x - NEITHER[j]) * k); });
      hatchBelow(g, rows, cols, this.frame.box, i => Math.min(inkOf(picture, i), inkOf(other, i)) > .3 ? (picture.depth_m[i] - other.depth_m[i]) / high : 0); }
    else { image(g, picture.albedo, rows, cols, this.frame.box, (v, i) => redBlue(.5 + .5 * (v - other.albedo[i]))); hatchBelow(g, rows, cols, this.frame.box, i => picture.albedo[i] - other.albedo[i]); }
    if (this.kind === "depth") outline(g, picture, rows, cols, this.frame.box);
    this.canvas.removeAttribute("aria-labelledby"); this.canvas.setAttribute("aria-label", `${this.title.textContent}: ${this.kind === "front" || this.kind === "depth" ? inWords(picture) : "the first less the second"}`);
    g.restore(); axes(g, this.frame, wall);
    const bar = tall ? (...what) => flatBar(g, bx, by + bh + 44, bw, ...what) : (...what) => colourBar(g, bx + bw + 12, by, bh, ...what);
    if (this.kind === "depth") bar(low, high, v => viridis(1 - v), "depth from the wall (m)");
    else if (this.kind === "front") bar(0, 1, gray, "brightness (relative)" + (hatched ? ", hatched: likely no surface" : ""));
    else if (this.kind === "deeper") bar(low, high, v => redBlue(v), "difference (m), hatched: nearer");
    else bar(-1, 1, redBlue, "first less second, hatched: below 0");
    if (this.kind !== "difference") this.trails(g);
    if (overlaid) this.points(g); if (this.keyed) this.ring(g); this.other = other; this.readOut();
  }
  // What the pointer does, by keys: the brightest pixel first, then the next one to any side; what is there is said.
  step(e) {
    const p = this.picture, side = asides[e.key]; if (!this.frame || e.ctrlKey || e.metaKey || e.altKey || !(side || (e.key === "Enter" && this.keyed))) return;
    e.preventDefault(); e.stopPropagation(); if (!side) { pinAt(this.scan, ...this.frame.metres(...this.cursor)); return; }
    const [rows, cols] = p.albedo.shape, within = (v, n) => Math.min(n - 1, Math.max(0, v)); let at = p.albedo.indexOf(p.albedo.reduce((a, b) => Math.max(a, b))), [col, row] = [at % cols, Math.floor(at / cols)];
    if (this.keyed) { const [x, y] = this.frame.metres(...this.cursor); [col, row] = [within(Math.floor((x / p.wall[0] + .5) * cols) + side[0], cols), within(Math.floor((.5 - y / p.wall[1]) * rows) - side[1], rows)]; }
    this.keep(this.frame.at(((col + .5) / cols - .5) * p.wall[0], (.5 - (row + .5) / rows) * p.wall[1]));
  }
  keep(cursor) { this.cursor = cursor; this.keyed = !!cursor; this.say.ariaLive = cursor ? "polite" : "off"; if (this.picture) this.draw(this.picture, this.limits, this.other); }
  ring(g) { const [x, y] = this.cursor; g.beginPath(); g.arc(x, y, 7, 0, 7); g.strokeStyle = "#000"; g.lineWidth = 3.5; g.stroke(); g.strokeStyle = "#fff"; g.lineWidth = 1.8; g.stroke(); }
  trails(g) { // of a film: where its objects were, a ring where each is now, and how fast
    const film = frame === null ? scans[this.scan].state.film : this.picture.of_film; if (!film) return; g.save(); g.lineWidth = 2; g.textBaseline = "bottom"; g.textAlign = "left";
    film.objects.forEach(one => { g.strokeStyle = g.fillStyle = TRAILS[one.object % TRAILS.length]; g.beginPath(); one.x_m.forEach((x, i) => g.lineTo(...this.frame.at(x, one.y_m[i]))); g.stroke();
      const [px, py] = this.frame.at(one.x_m[one.x_m.length - 1], one.y_m[one.y_m.length - 1]), v = one.velocity_m_per_s; g.beginPath(); g.arc(px, py, 5, 0, 7); g.stroke();
      if (v.every(c => c !== null)) g.fillText(speedWords(v, one.error_m_per_s), px + 8, py - 4); });
    g.restore();
  }
  points(g) {
    const known = scans[this.scan]; if (!known.plan || !known.rates) return; const {x, y} = known.plan, size = Math.max(1.2, Math.min(3, this.frame.scale * known.pitch * .22));
    g.fillStyle = inks.mark; g.globalAlpha = .55;
    for (let i = 0; i < x.length; i++) if (Number.isFinite(known.rates[i])) { const [px, py] = this.frame.at(x[i], y[i]); g.fillRect(px - size / 2, py - size / 2, size, size); }
    g.globalAlpha = 1; const at = known.state.status === "running" ? placeOf(known, known.state.samples) : -1;
    if (at >= 0) { const [px, py] = this.frame.at(x[at], y[at]); g.strokeStyle = inks.mark; g.lineWidth = 2; g.beginPath(); g.arc(px, py, 7, 0, 7); g.stroke(); }
  }
  readOut() {
    const p = this.picture; if (!p || !this.frame) { this.say.textContent = ""; return; }
    const [rows, cols] = p.albedo.shape, [x, y] = this.cursor ? this.frame.metres(...this.cursor) : [NaN, NaN];
    const col = Math.floor((x / p.wall[0] + .5) * cols), row = Math.floor((.5 - y / p.wall[1]) * rows), i = row * cols + col;
    if (!(row >= 0 && row < rows && col >= 0 && col < cols)) { this.say.replaceChildren(...this.about()); return; }
    const d = p.depth_m[i], value = this.kind === "deeper" ? this.deeper(d, this.other.depth_m[i]) : this.kind === "difference" ? `difference ${(p.albedo[i] - this.other.albedo[i]).toFixed(3)}` : `brightness ${p.albedo[i].toFixed(3)}, ` + (Number.isFinite(d) ? `depth ${d.toFixed(3)} m` : "no depth") + (p.seen ? `, a surface at ${(100 * p.seen[i]).toFixed(0)} %` : "");
    this.say.textContent = `x ${x.toFixed(3)} m, y ${y.toFixed(3)} m: ${value}`;
  }
  deeper(d, other) {
    if (!Number.isFinite(d) || !Number.isFinite(other)) return "no depth in one of them";
    return `depths ${d.toFixed(3)} and ${other.toFixed(3)} m, the first ${fixed(1e3 * Math.abs(d - other), 1)} mm ${d > other ? "farther away" : "nearer"}`;
  }
  isOld(p) { const state = scans[this.scan].state; return !!p && !!state && frame === null && state.samples - p.samples > .02 * state.planned; }
  about() {
    const whose = q => `${q.method.toUpperCase()} of ${count(q.samples)} points`;
    if (this.kind === "deeper") { const [one, other] = [whose(this.picture), whose(this.other)]; return [document.createTextNode(`${one === other ? one : `${one} less ${other}`}; red: the first is farther away, hatched: it is nearer`)]; }
    if (this.kind === "difference") return [document.createTextNode(`${whose(this.picture)} less ${whose(this.other)}`)];
    const p = this.picture, state = scans[this.scan].state, since = state.samples - p.samples, old = this.isOld(p), span = document.createElement("span");
    span.className = old ? "stale" : ""; span.textContent = frame === null && old ? `older picture, of ${count(p.samples)} points: ${count(since)} more were taken since` : `of ${count(p.samples)} points`;
    const rest = p.change < 1 && frame === null ? `, changed by ${(100 * p.change).toFixed(1)} % from the previous picture (${p.change <= SETTLED ? "settled" : "still changing"})` : "";
    const bound = p.bound === null ? "" : p.bound >= 1 ? ", error up to all of its strength (not good yet)" : `, error below ${(100 * p.bound).toFixed(0)} % of its strength in nine cases of ten (${p.bound <= SURE ? "good" : "not good yet"})`;
    const said = document.createElement("span"); said.className = p.explains_nothing ? "nothing" : ""; said.textContent = p.explained ? `, ${p.explained}` + (p.verdict && ` (${p.verdict})`) : "";
    const quick = p.refined ? "" : ", not refined, to keep up";
    return [document.createTextNode(`${p.method.toUpperCase()} `), span, document.createTextNode(quick + rest + bound), said];
  }
}
