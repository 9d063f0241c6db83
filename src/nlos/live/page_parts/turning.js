// The third kind of panel, 3D: bright voxels, surface or slices, turned by hand; drawn by recon/view3d.js.
const SOLID = SOLID_AT; // in 3D a point is shown at first from this brightness on
const MODES = {points: "bright voxels", surface: "surface", slices: "slices"};
const solidly = {mode: "points", threshold: SOLID, slice: null}; // as chosen, whatever panel shows it
function element(name, properties, ...inside) {
  const made = Object.assign(document.createElement(name), properties); made.append(...inside); return made;
}
function slider(name, value, low, told, change) {
  const range = element("input", {type: "range", min: low, max: 1, step: .005}), shown = element("output", {textContent: told(value)});
  range.value = value; range.setAttribute("aria-label", name); // the value last: a range rounds it to its step
  range.addEventListener("input", () => { change(+range.value); shown.textContent = told(+range.value); });
  return element("label", {}, name + " ", range, shown);
}
class TurnPanel {
  constructor(scan) {
    this.kind = "turn"; this.scan = scan; this.box = element("section", {className: "panel"}); this.box.dataset.kind = "turn";
    this.title = element("h2", {}); this.canvas = element("canvas", {id: panelName("turn", scan)});
    this.say = element("p", {className: "say"}); this.empty = element("div", {className: "empty"});
    named(this, "application"); this.controls = element("div", {className: "controls say"});
    this.box.append(this.title, this.canvas, this.say, this.controls, this.empty);
    this.view = turnable(this.canvas, () => ({back: inks.card, dim: inks.dim, grid: inks.grid}));
    this.view.say = text => { this.said = text; this.tell(); };
    this.setOut();
  }
  setOut() {
    const modes = Object.entries(MODES).map(([mode, name]) => {
      const button = element("button", {textContent: name}); button.setAttribute("aria-pressed", solidly.mode === mode);
      button.addEventListener("click", () => showAs(mode)); return button;
    });
    const save = element("button", {textContent: "Save as PNG"});
    save.addEventListener("click", () => element("a", {download: `${scans[this.scan].state.run}-3d.png`, href: this.canvas.toDataURL("image/png")}).click());
    const [x, y, z] = solidly.slice || [.5, .5, .5], move = axis => v => { solidly.slice[axis] = v; this.set(); };
    const sliders = solidly.mode === "slices" ? [slider("slice at x", x, 0, v => this.metres(0, v), move(0)), slider("y", y, 0, v => this.metres(1, v), move(1)), slider("z", z, 0, v => this.metres(2, v), move(2))]
      : [slider("from brightness", solidly.threshold, FAINT, v => v.toFixed(2), v => { solidly.threshold = v; this.set(); })];
    this.controls.replaceChildren(...modes, ...sliders, save);
  }
  metres(axis, v) {
    const p = this.picture, solid = p && p.solid; if (!solid || !solid.depths) return "";
    return (axis < 2 ? (v - .5) * p.wall[axis] : solid.depths[0] + v * (solid.depths[1] - solid.depths[0])).toFixed(2) + " m";
  }
  set() {
    Object.assign(this.view, {mode: solidly.mode, threshold: solidly.threshold, slice: solidly.slice || [.5, .5, .5]}); this.view.redraw();
  }
  tell() {
    const p = this.picture, solid = p && p.solid, lacks = solid && ((solidly.mode === "slices" && !solid.volume) || (solidly.mode === "surface" && !solid.quads));
    this.say.textContent = this.said || (lacks ? `${p.method.toUpperCase()} makes no ${solidly.mode === "slices" ? "volume to slice" : "surface here"}: points are shown`
      : "drag or arrow keys to turn, wheel to zoom" + (p ? `; ${p.method.toUpperCase()} of ${count(p.samples)} points` : ""));
  }
  // Surface and volume are asked for when they are looked at.
  async need(picture) {
    if (solidly.mode === "points" || picture.solid || picture.asking) return;
    picture.asking = true;
    const which = picture.frame === undefined ? `method=${picture.method}` : `frame=${picture.frame}`;
    try { const got = await ask(`solid?scan=${this.scan}&${which}`); if (got.samples === picture.samples && got.method === picture.method) picture.solid = unpackedScene(got); }
    finally { picture.asking = false; }
    if (picture.solid && picture === this.picture) {
      if (!solidly.slice && picture.solid.at) solidly.slice = picture.solid.at.slice();
      this.setOut();
      this.picture = null; this.draw(picture, this.limits);
    }
  }
  draw(picture, limits) {
    this.empty.hidden = !!picture; const same = picture === this.picture && limits === this.limits; this.picture = picture; this.limits = limits; this.tell();
    if (!picture) return;
    if (picture.points.f4) picture.points = unpacked(picture.points);
    this.need(picture);
    if (!same) this.view.show({...picture.solid, points: picture.points, wall: picture.wall, near: limits[0], far: Math.max(limits[1], .1), pitch: picture.wall[0] / picture.albedo.shape[1]});
    this.set();
  }
}
function showAs(mode) { solidly.mode = mode; for (const panel of panels) if (panel.kind === "turn") { panel.setOut(); if (panel.picture) panel.draw(panel.picture, panel.limits); } }
function showNext() { const names = Object.keys(MODES); showAs(names[(names.indexOf(solidly.mode) + 1) % names.length]); }
