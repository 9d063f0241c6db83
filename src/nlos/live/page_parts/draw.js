// What every drawing here shares: numbers, colours, ticks and a canvas as sharp as the screen.
const $ = id => document.getElementById(id);
const put = (element, text) => { if (element.textContent !== String(text)) element.textContent = text; }; // words that stay cost no layout
const LONGEST_MS = 20_000; // an answer that takes longer is asked for anew: a line that was cut may never say so
const ask = async (path, longestMs = LONGEST_MS) => { const r = await fetch(path, {cache: "no-store", signal: AbortSignal.timeout(longestMs)}); if (!r.ok && r.status !== 404) throw Error(r.status); return r.json(); };
const noAnswer = error => error instanceof TypeError || error instanceof DOMException || error instanceof SyntaxError || /^[45]/.test(error.message); // SyntaxError: what came is no JSON, but from somebody on the way; else a fault of the page itself
const LITTLE = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1; // which byte of a number comes first here
function unpacked(packed) {
  const text = atob(packed.f4), bytes = new Uint8Array(text.length); for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  const out = new Float32Array(bytes.buffer), view = new DataView(bytes.buffer); if (!LITTLE) for (let i = 0; i < out.length; i++) out[i] = view.getFloat32(4 * i, true);
  out.shape = packed.shape; return out;
}
const VIRIDIS = [[68,1,84],[72,40,120],[62,74,137],[49,104,142],[38,130,142],[31,158,137],[53,183,121],[109,205,89],[180,222,44],[253,231,37]];
const RED_BLUE = [[33,102,172],[146,197,222],[247,247,247],[244,165,130],[178,24,43]];
const along = stops => v => {
  const x = Math.min(.9999, Math.max(0, v)) * (stops.length - 1), i = x | 0, f = x - i;
  return stops[i].map((c, k) => c + (stops[i + 1][k] - c) * f);
};
const viridis = along(VIRIDIS), redBlue = along(RED_BLUE), gray = v => { const c = 255 * Math.min(1, Math.max(0, v)); return [c, c, c]; };
let inks = {};
function readInks() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["back", "card", "text", "dim", "line", "empty", "bar", "mark", "grid", "warn", "good"]) inks[name] = style.getPropertyValue("--" + name).trim();
  inks.emptyRgb = [1, 3, 5].map(i => parseInt(inks.empty.slice(i, i + 2), 16));
}
function pen(canvas) {
  const ratio = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio); }
  const g = canvas.getContext("2d"); g.setTransform(ratio, 0, 0, ratio, 0, 0); g.clearRect(0, 0, w, h);
  g.font = "12px system-ui, sans-serif"; g.fillStyle = inks.dim; g.strokeStyle = inks.grid; g.lineWidth = 1;
  return [g, w, h];
}
function ticks(low, high, most) {
  const raw = (high - low) / Math.max(1, most), power = 10 ** Math.floor(Math.log10(raw || 1)), step = [1, 2, 5, 10].map(k => k * power).find(s => s >= raw * .999) || power;
  const out = []; for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) out.push(k * step);
  return [out, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
}
const fixed = (x, digits) => (Math.abs(x) < .5 * 10 ** -digits ? 0 : x).toFixed(digits);
const count = n => Math.round(n).toLocaleString("en");
const seconds = s => s === null || s === undefined ? "–" : s < 9.95 ? s.toFixed(1) + " s" : s < 99.5 ? s.toFixed(0) + " s" : s < 5940 ? (s / 60).toFixed(1) + " min" : (s / 3600).toFixed(1) + " h";
const rate = hz => (hz >= 1e6 ? (hz / 1e6).toFixed(2) + " million" : Number(hz.toPrecision(3)).toLocaleString("en")) + " counts/s";
function quantiles(values, ...q) {
  const v = Array.from(values).filter(Number.isFinite).sort((a, b) => a - b);
  return v.length ? q.map(x => v[Math.round(x * (v.length - 1))]) : q.map((x, i) => i);
}
// A rectangle in metres fitted into a canvas, its axes drawn; returns from metres to pixels and back.
function wallFrame(g, w, h, wall, margin) {
  const [left, top, right, bottom] = margin, scale = Math.min((w - left - right) / wall[0], (h - top - bottom) / wall[1]);
  const x0 = left + (w - left - right - scale * wall[0]) / 2, y0 = top + (h - top - bottom - scale * wall[1]) / 2;
  const box = [x0, y0, scale * wall[0], scale * wall[1]];
  return {box, scale, at: (x, y) => [x0 + (x + wall[0] / 2) * scale, y0 + (wall[1] / 2 - y) * scale],
    metres: (px, py) => [(px - x0) / scale - wall[0] / 2, wall[1] / 2 - (py - y0) / scale]};
}
function axes(g, frame, wall) {
  const [bx, by, bw, bh] = frame.box; g.strokeStyle = inks.dim; g.fillStyle = inks.dim; g.strokeRect(bx - .5, by - .5, bw + 1, bh + 1);
  const [xs, dx] = ticks(-wall[0] / 2, wall[0] / 2, Math.max(2, Math.min(6, bw / 70))), [ys, dy] = ticks(-wall[1] / 2, wall[1] / 2, Math.max(2, Math.min(6, bh / 50)));
  g.textAlign = "center"; g.textBaseline = "top"; g.beginPath();
  for (const x of xs) { const [px] = frame.at(x, 0); g.moveTo(px, by + bh); g.lineTo(px, by + bh + 4); g.fillText(fixed(x, dx), px, by + bh + 6); }
  g.fillText("x (m)", bx + bw / 2, by + bh + 20); g.textAlign = "right"; g.textBaseline = "middle";
  for (const y of ys) { const [, py] = frame.at(0, y); g.moveTo(bx, py); g.lineTo(bx - 4, py); g.fillText(fixed(y, dy), bx - 7, py); }
  g.stroke(); g.save(); g.translate(bx - 40, by + bh / 2); g.rotate(-Math.PI / 2); g.textAlign = "center"; g.fillText("y (m)", 0, 0); g.restore();
}
function colourBar(g, x, y, h, low, high, colour, label) {
  const steps = Math.ceil(h); image(g, [], steps, 1, [x, y, 12, h], (_, i) => colour(1 - i / steps));
  g.strokeStyle = inks.dim; g.strokeRect(x - .5, y - .5, 13, h + 1); g.fillStyle = inks.dim; g.textAlign = "left"; g.textBaseline = "middle";
  const [marks, digits] = ticks(Math.min(low, high), Math.max(low, high), Math.max(4, h / 45));
  for (const v of marks) { const py = y + h * (1 - (v - low) / (high - low || 1)); g.fillText(fixed(v, digits), x + 17, py); }
  const lines = g.measureText(label).width > h + 14 ? label.split(", ") : [label]; // one beside the other where the bar is short
  const middle = Math.max(y + h / 2, Math.max(...lines.map(line => g.measureText(line).width)) / 2 + 2); // not beyond the upper edge
  g.save(); g.translate(x + 57, middle); g.rotate(-Math.PI / 2); g.textAlign = "center"; lines.forEach((line, i) => g.fillText(line, 0, 13 * i)); g.restore();
}
function flatBar(g, x, y, w, low, high, colour, label) {
  const steps = Math.ceil(w); image(g, [], 1, steps, [x, y, w, 12], (_, i) => colour(i / steps));
  g.strokeStyle = inks.dim; g.strokeRect(x - .5, y - .5, w + 1, 13); g.fillStyle = inks.dim; g.textAlign = "center"; g.textBaseline = "top";
  const [marks, digits] = ticks(Math.min(low, high), Math.max(low, high), Math.max(2, w / 60));
  for (const v of marks) g.fillText(fixed(v, digits), x + w * (v - low) / (high - low || 1), y + 17);
  g.fillText(label, x + w / 2, y + 33);
}
function image(g, values, rows, cols, box, pixel) {
  const small = image.canvas || (image.canvas = document.createElement("canvas")); small.width = cols; small.height = rows;
  const pencil = small.getContext("2d"), data = pencil.createImageData(cols, rows);
  for (let i = 0, k = 0; i < rows * cols; i++, k += 4) { const c = pixel(values[i], i); data.data[k] = c[0]; data.data[k + 1] = c[1]; data.data[k + 2] = c[2]; data.data[k + 3] = 255; }
  pencil.putImageData(data, 0, 0); g.imageSmoothingEnabled = false; g.drawImage(small, ...box);
}
