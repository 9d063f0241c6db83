// The slider along the time of a finished scan: which of its steps the page shows, and how they are played.
// A film's steps are its frames, played at its own pace: where the page is too slow for that, frames are passed over.
let playing = null, passedOver = 0, playedFrom = [1, 0];
function stepOf(known) { // the slider has the steps of the first scan; another one's, as far along
  const steps = known.state.frames.length, all = scans[0].state.frames.length;
  return steps === all ? frame : Math.max(0, Math.round((frame + 1) * steps / all) - 1);
}
function tellSlider(scan) {
  const state = scan.state, ready = scan.frames.filter(f => f).length, steps = state.frames.length, of = frame === null ? null : (scan.frames[stepOf(scan)] || {}).of_film;
  $("slider").hidden = !scans.every(s => s.state.over);
  $("time").max = steps;
  if (frame === null) $("time").value = steps; // the whole scan, however many steps there turn out to be
  const points = frame === null ? state.samples : state.frames[frame];
  const some = state.film && scan.frames.length && steps < state.film.frame ? `, ${steps} of ${count(state.film.frame)} frames are shown` : "";
  const after = of ? `at ${of.time_s.toFixed(2)} s${some}` : points ? `after ${count(points)} of ${count(state.samples)} points${some}` : "being made";
  $("first").textContent = after + (ready < steps ? ` (${ready} of ${steps} steps ready)` : passedOver ? `, ${count(passedOver)} passed over` : "");
  $("play").lastChild.textContent = playing ? " Stop" : " Play";
}
function seek(value, byHand = true) { // the last place is the whole scan
  const last = +$("time").max, to = Math.min(last, Math.max(1, value));
  if (byHand) playedFrom = [to, performance.now()];
  $("time").value = to;
  frame = to >= last ? null : to - 1;
  if (frame === null) for (const s of scans) s.back = true;
  tell(); draw();
}
function step(by) { seek(+$("time").value + by); }
function stepMs() { // between two steps; of a film as it was scanned
  const times = scans[0].frames.filter(f => f && f.of_film).map(f => f.of_film.time_s);
  const apart = times.slice(1).map((time, k) => time - times[k]).sort((a, b) => a - b); // the usual one: a film may have been resumed
  return apart.length ? Math.min(1000, Math.max(40, 1e3 * apart[apart.length >> 1])) : 180;
}
function play() {
  if (playing) { clearInterval(playing); playing = null; }
  else {
    const last = () => +$("time").value >= +$("time").max;
    if (last()) seek(1);
    const ms = stepMs(); passedOver = 0; playedFrom = [+$("time").value, performance.now()];
    playing = setInterval(() => {
      const at = +$("time").value, to = Math.min(+$("time").max, playedFrom[0] + Math.floor((performance.now() - playedFrom[1]) / ms));
      if (to > at) { passedOver += to - at - 1; seek(to, false); if (last()) play(); }
    }, ms / 4);
  }
  tell();
}
function sliderKey(e) {
  if ($("slider").hidden || e.key === " " && e.target.matches("button:focus-visible")) return; // who came there by keys presses it
  if (e.key === " ") { e.preventDefault(); play(); }
  else if (e.target !== $("time") && e.key === "ArrowLeft") step(-1);
  else if (e.target !== $("time") && e.key === "ArrowRight") step(1);
}
$("play").addEventListener("click", play);
$("time").addEventListener("input", () => seek(+$("time").value));
