// The slider along the time of a finished scan: which of its steps the page shows, and how they are played.
let playing = null;
function tellSlider(scan) {
  const state = scan.state, ready = scan.frames.filter(f => f).length, steps = state.frames.length;
  $("slider").hidden = !scans.every(s => s.state.over);
  $("time").max = steps;
  const points = frame === null ? state.samples : state.frames[frame];
  const after = points ? `after ${count(points)} of ${count(state.samples)} points` : "being made";
  $("first").textContent = after + (ready < steps ? ` (${ready} of ${steps} steps ready)` : "");
  $("play").lastChild.textContent = playing ? " Stop" : " Play";
}
function seek(value) { // the last place is the whole scan
  const last = +$("time").max, to = Math.min(last, Math.max(1, value));
  $("time").value = to;
  frame = to >= last ? null : to - 1;
  if (frame === null) for (const s of scans) s.back = true;
  tell(); draw();
}
function step(by) { seek(+$("time").value + by); }
function play() {
  if (playing) { clearInterval(playing); playing = null; }
  else {
    const last = () => +$("time").value >= +$("time").max;
    if (last()) seek(1);
    playing = setInterval(() => { step(1); if (last()) play(); }, 180);
  }
  tell();
}
function sliderKey(e) {
  if ($("slider").hidden) return;
  if (e.key === " ") { e.preventDefault(); play(); }
  else if (e.target !== $("time") && e.key === "ArrowLeft") step(-1);
  else if (e.target !== $("time") && e.key === "ArrowRight") step(1);
}
$("play").addEventListener("click", play);
$("time").addEventListener("input", () => seek(+$("time").value));
