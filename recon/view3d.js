// What Python packed: floats in base64, and the volume a byte a voxel.
function unpackedScene(scene) {
  const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
  const floats = text => { const b = bytes(text), v = new DataView(b.buffer), out = new Float32Array(b.length / 4); for (let i = 0; i < out.length; i++) out[i] = v.getFloat32(4 * i, true); return out; };
  const ready = {...scene, surface: floats(scene.surface), quads: scene.quads ? Uint32Array.from(floats(scene.quads)) : null};
  if (scene.points) ready.points = floats(scene.points);
  if (scene.volume) ready.volume = {shape: scene.volume.shape, bytes: bytes(scene.volume.u1)};
  return ready;
}
// A scene that is turned by hand: bright voxels, surface or slices in front of the wall; orthographic, on a 2D canvas.
function turnable(canvas, paper) {
  const stops = [[253,231,37],[180,222,44],[109,205,89],[53,183,121],[31,158,137],[38,130,142],[49,104,142],[62,74,137],[82,60,140]];
  const self = {threshold: .15, size: 1.2, coloured: true, mode: "points", slice: [.5, .5, .5]};
  let scene = null, turn, tilt, zoom, shift, cursor = null, keyed = false, waiting = false, projected = [], planes = {}; const held = new Map(); // pointers that are down, and where
  self.startOver = () => { turn = -.45; tilt = .22; zoom = 1; shift = [0, 0]; aim(false); self.redraw(); };
  function aim(byKeys) { if (keyed && !byKeys) cursor = null; keyed = byKeys; } // then what is in the middle is read out
  const metres = (v, least) => v.toFixed(Math.max(2, 1 - Math.floor(Math.log10(least) + 1e-9)));
  self.show = next => { scene = next; planes = {}; self.redraw(); };
  self.redraw = () => { if (!waiting) { waiting = true; requestAnimationFrame(() => { waiting = false; draw(); }); } };
  self.say = () => {};
  const mixed = (a, b, part) => a.map((c, i) => c + (b[i] - c) * part), luma = c => (.299 * c[0] + .587 * c[1] + .114 * c[2]) / 255;
  const depthColour = t => { const at = Math.min(.9999, Math.max(t, 0)) * (stops.length - 1), k = at | 0; return mixed(stops[k], stops[k + 1], at - k); };
  // What is far is no dimmer than what is near: a colour that would drown in the page is made lighter, or darker.
  const LIGHT_ENOUGH = .6, DARK_ENOUGH = .5;
  const readable = (c, ground) => { const l = luma(c); return luma(ground) < .5 ? mixed(c, [255, 255, 255], Math.max(0, (LIGHT_ENOUGH - l) / (1 - l))) : mixed(c, [0, 0, 0], Math.max(0, 1 - DARK_ENOUGH / l)); };
  function draw() {
    const ratio = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight, ink = paper();
    if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio); }
    const g = canvas.getContext("2d"); g.setTransform(ratio, 0, 0, ratio, 0, 0); g.fillStyle = ink.back; g.fillRect(0, 0, w, h); projected = [];
    const ground = [1, 3, 5].map(i => parseInt(g.fillStyle.slice(i, i + 2), 16)); // a canvas says colours as #rrggbb
    if (!scene) return;
    const {wall} = scene, far = self.mode === "slices" && scene.volume ? Math.max(scene.far, scene.depths[1]) : scene.far, [wide, high] = wall, middle = far / 2, scale = Math.min(w, h) / Math.hypot(wide, high, far) * zoom * 1.15;
    const ct = Math.cos(turn), st = Math.sin(turn), cp = Math.cos(tilt), sp = Math.sin(tilt);
    // The viewer looks towards the wall as into a mirror: x goes right, y up, +z away. Bigger third coordinate: farther away.
    const project = (x, y, z) => { const dz = z - middle, x1 = ct * x + st * dz, z1 = -st * x + ct * dz; return [w / 2 + x1 * scale + shift[0], h / 2 - (cp * y + sp * z1) * scale + shift[1], -sp * y + cp * z1]; };
    const line = (a, b, style, wideness) => { const p = project(...a), q = project(...b); g.strokeStyle = style; g.lineWidth = wideness || 1; g.beginPath(); g.moveTo(p[0], p[1]); g.lineTo(q[0], q[1]); g.stroke(); };
    const X = wide / 2, Y = high / 2, corners = [[-X, -Y], [X, -Y], [X, Y], [-X, Y]];
    corners.forEach(([x, y], i) => { const [u, v] = corners[(i + 1) % 4]; line([x, y, far], [u, v, far], ink.grid); line([x, y, 0], [x, y, far], ink.grid); });
    // Brightness is albedo's alone: what is faint comes near the page's own colour, whether that is dark or light.
    const plain = luma(ground) < .5 ? [255, 255, 255] : [0, 0, 0];
    const shade = (z, v, facing = 1) => { const [low, top] = [scene.near, scene.far], t = top > low ? (z - low) / (top - low) : 0, c = self.coloured ? readable(depthColour(t), ground) : plain; return `rgb(${mixed(ground, c, (.2 + .8 * Math.sqrt(v)) * (.4 + .6 * facing)).map(Math.round)})`; };
    if (self.mode === "surface" && scene.quads) drawSurface(g, project, shade); else if (self.mode === "slices" && scene.volume) drawSlices(g, project); else drawPoints(g, project, shade, scale);
    corners.forEach(([x, y], i) => { const [u, v] = corners[(i + 1) % 4]; line([x, y, 0], [u, v, 0], ink.dim, 1.5); });
    g.fillStyle = ink.dim; g.font = "12px system-ui, sans-serif"; g.textAlign = "left"; g.textBaseline = "alphabetic";
    const label = (text, at, down = -4) => { const p = project(...at); g.fillText(text, p[0] + 4, p[1] + down); };
    label(`wall, ${metres(wide, Math.min(wide, high))} x ${metres(high, Math.min(wide, high))} m`, [-X, -Y, 0], 14); label("y+", [-X, Y, 0]); label("x+", [X, -Y, 0]); label("z, from the wall", [X, -Y, far]);
    const [nearer, farther] = [project(X, -Y, 0), project(X, -Y, far)], apart = Math.hypot(nearer[0] - farther[0], nearer[1] - farther[1]) / far;
    const least = Math.max(52 / Math.max(apart, 1e-6), 1e-6), power = 10 ** Math.floor(Math.log10(least)), step = [1, 2.5, 5, 10].map(k => k * power).find(s => s >= least * .999);
    for (let k = 1; k * step <= far * (1 + 1e-9); k++) { const z = k * step; line([X, -Y, z], [X, -Y - .02 * high, z], ink.dim); const p = project(X, -Y - .03 * high, z); g.fillText(`${metres(z, step)} m`, p[0] + 2, p[1] + 12); }
    if (keyed) { const [x, y] = cursor = [w / 2, h / 2]; g.strokeStyle = ink.dim; g.lineWidth = 1; g.beginPath(); g.moveTo(x - 9, y); g.lineTo(x + 9, y); g.moveTo(x, y - 9); g.lineTo(x, y + 9); g.stroke(); }
    readOut();
  }
  function drawPoints(g, project, shade, scale) {
    const {points, pitch} = scene, side = Math.max(1, pitch * scale * self.size), n = points.length / 4;
    for (let i = 0; i < n; i++) if (points[4 * i + 3] >= self.threshold) projected.push([i, ...project(points[4 * i], points[4 * i + 1], points[4 * i + 2])]);
    projected.sort((a, b) => b[3] - a[3]);
    for (const [i, px, py] of projected) { g.fillStyle = shade(points[4 * i + 2], points[4 * i + 3]); g.fillRect(px - side / 2, py - side / 2, side, side); }
  }
  function drawSurface(g, project, shade) {
    const {surface: s, quads} = scene, at = []; for (let i = 0; i < s.length / 4; i++) at.push(project(s[4 * i], s[4 * i + 1], s[4 * i + 2]));
    const faces = []; for (let q = 0; q < quads.length; q += 4) { const k = [0, 1, 2, 3].map(j => quads[q + j]), v = Math.min(...k.map(j => s[4 * j + 3])); if (v >= self.threshold) faces.push([k, k.reduce((sum, j) => sum + at[j][2], 0), v]); }
    faces.sort((a, b) => b[1] - a[1]);
    for (const [k, , v] of faces) {
      const [a, b, d] = [k[0], k[1], k[3]], u = [0, 1, 2].map(i => s[4 * b + i] - s[4 * a + i]), t = [0, 1, 2].map(i => s[4 * d + i] - s[4 * a + i]);
      const n = [u[1] * t[2] - u[2] * t[1], u[2] * t[0] - u[0] * t[2], u[0] * t[1] - u[1] * t[0]], facing = Math.abs(n[2] * .85 + n[1] * .4 + n[0] * .3) / (Math.hypot(...n) || 1);
      g.fillStyle = g.strokeStyle = shade(s[4 * a + 2], v, facing); g.lineWidth = .7; g.beginPath(); k.forEach((j, i) => i ? g.lineTo(at[j][0], at[j][1]) : g.moveTo(at[j][0], at[j][1])); g.closePath(); g.fill(); g.stroke();
    }
    at.forEach((p, i) => { if (s[4 * i + 3] >= self.threshold) projected.push([i, ...p]); });
  }
  // A slice of the volume is a parallelogram on the screen: one affine transformation.
  function drawSlices(g, project) {
    const {volume, wall, depths} = scene, [D, H, W] = volume.shape, [X, Y] = [wall[0] / 2, wall[1] / 2], [z0, z1] = depths;
    const d = Math.round(self.slice[2] * (D - 1)), r = Math.round((1 - self.slice[1]) * (H - 1)), c = Math.round(self.slice[0] * (W - 1));
    const zd = z0 + (z1 - z0) * d / (D - 1 || 1), yr = Y - (r + .5) * 2 * Y / H, xc = -X + (c + .5) * 2 * X / W;
    const parts = [[W, H, (i, j) => (d * H + j) * W + i, [-X, Y, zd], [X, Y, zd], [-X, -Y, zd]], [W, D, (i, j) => (j * H + r) * W + i, [-X, yr, z0], [X, yr, z0], [-X, yr, z1]], [D, H, (i, j) => (i * H + j) * W + c, [xc, Y, z0], [xc, Y, z1], [xc, -Y, z0]]];
    parts.map((p, k) => [p, k, project(...p[3].map((v, i) => (p[4][i] + p[5][i]) / 2))[2]]).sort((a, b) => b[2] - a[2]).forEach(([[w, h, index, o, a, b], k]) => {
      const key = [k, d, r, c][0] + ":" + [d, r, c][k]; if (!planes[key]) { const small = document.createElement("canvas"); small.width = w; small.height = h; const pencil = small.getContext("2d"), data = pencil.createImageData(w, h);
        for (let j = 0; j < h; j++) for (let i = 0; i < w; i++) { const v = volume.bytes[index(i, j)], m = 4 * (j * w + i); data.data[m] = data.data[m + 1] = data.data[m + 2] = v; data.data[m + 3] = 60 + .76 * v; } pencil.putImageData(data, 0, 0); planes[key] = small; }
      const [p, q, s] = [project(...o), project(...a), project(...b)]; g.save(); g.transform((q[0] - p[0]) / w, (q[1] - p[1]) / w, (s[0] - p[0]) / h, (s[1] - p[1]) / h, p[0], p[1]); g.drawImage(planes[key], 0, 0); g.restore();
    });
  }
  function readOut() {
    if (!cursor || !scene) { self.say(""); return; }
    let best = null, least = 14 * 14; const from = self.mode === "surface" && scene.quads ? scene.surface : scene.points;
    for (const p of projected) { const d = (p[1] - cursor[0]) ** 2 + (p[2] - cursor[1]) ** 2; if (d < least || (d < 36 && best && p[3] < best[3])) { least = Math.min(least, d); best = p; } }
    self.say(best ? `x ${from[4 * best[0]].toFixed(3)} m, y ${from[4 * best[0] + 1].toFixed(3)} m, z ${from[4 * best[0] + 2].toFixed(3)} m: brightness ${from[4 * best[0] + 3].toFixed(2)}` : "");
  }
  canvas.addEventListener("pointerdown", e => { held.set(e.pointerId, [e.clientX, e.clientY]); canvas.setPointerCapture(e.pointerId); });
  for (const over of ["pointerup", "pointercancel"]) canvas.addEventListener(over, e => { held.delete(e.pointerId); });
  canvas.addEventListener("pointerleave", () => { if (!keyed) cursor = null; readOut(); });
  canvas.addEventListener("blur", () => { aim(false); self.redraw(); });
  canvas.addEventListener("pointermove", e => {
    aim(false); cursor = [e.offsetX, e.offsetY]; const last = held.get(e.pointerId); if (!last) { readOut(); return; }
    const dx = e.clientX - last[0], dy = e.clientY - last[1], still = [...held].find(([id]) => id !== e.pointerId); held.set(e.pointerId, [e.clientX, e.clientY]);
    if (still) { // two fingers: apart to zoom, together to move
      const off = ([x, y]) => Math.max(1, Math.hypot(x - still[1][0], y - still[1][1])); zoom = Math.min(20, Math.max(.2, zoom * off([e.clientX, e.clientY]) / off(last))); shift[0] += dx / 2; shift[1] += dy / 2;
    } else if (e.shiftKey) { shift[0] += dx; shift[1] += dy; } else { turn += dx * .008; tilt = Math.min(Math.max(tilt + dy * .008, -1.57), 1.57); }
    self.redraw();
  });
  canvas.addEventListener("wheel", e => { e.preventDefault(); zoom = Math.min(20, Math.max(.2, zoom * Math.exp(-e.deltaY * .001))); self.redraw(); }, {passive: false});
  const turned = {ArrowLeft: [-12, 0], ArrowRight: [12, 0], ArrowUp: [0, -12], ArrowDown: [0, 12]}, zoomed = {"+": 1.15, "-": 1 / 1.15};
  canvas.tabIndex = 0; canvas.addEventListener("keydown", e => { // what the pointer does, in steps
    if (e.ctrlKey || e.metaKey || e.altKey) return; const by = turned[e.key];
    if (by && e.shiftKey) { shift[0] += by[0]; shift[1] += by[1]; }
    else if (by) { turn += by[0] * .008; tilt = Math.min(Math.max(tilt + by[1] * .008, -1.57), 1.57); }
    else if (zoomed[e.key]) zoom = Math.min(20, Math.max(.2, zoom * zoomed[e.key])); else if (e.key === "Home") self.startOver(); else return;
    if (e.key !== "Home") aim(true); e.preventDefault(); e.stopPropagation(); self.redraw();
  });
  canvas.addEventListener("dblclick", self.startOver); self.startOver(); return self;
}
