// What the page knows of each scan, how it asks for more, and what it says about it.
const WORDS = {waiting: "Waiting for the scan's file", missing: "No recording to show", running: "Scanning", paused: "Paused", complete: "Scan complete", interrupted: "Ended early", "ended as asked": "Ended as asked", stopped: "Stopped by an alarm", failed: "Failed", lost: "The scan was killed", unread: "The scan's file cannot be read"};
let scans = [], panels = [], chosen = 0, overlaid = false, compared = false, method = null, frame = null, gone = "", shape = ""; // gone: "" while the viewer answers, "ended", or "silent" where no answer comes
const placeOf = (known, n) => { const {order} = known.plan; return order[known.state.film ? n % order.length : Math.min(n, order.length - 1)]; }; // of the n-th point; a film's repeat
const brief = name => name.length > 48 ? `${name.slice(0, 30)}…${name.slice(-15)}` : name; // beside other words; the head of the page has it whole
const panelName = (kind, scan) => (kind === "front" ? "albedo" : kind === "turn" ? "volume" : kind) + (scan ? scan : "");
function opened(p) { return p && p.albedo ? {...p, albedo: unpacked(p.albedo), depth_m: unpacked(p.depth_m), seen: p.seen && unpacked(p.seen)} : null; }
function best(known) { // the newest picture of the best method that has one
  if (frame !== null) return known.frames[stepOf(known)] || null;
  const names = known.state.methods, wanted = method && names.includes(method) ? [method] : names.slice().reverse(); return wanted.map(m => known.pictures[m]).find(p => p) || null;
}
// Of a film under way pictures come many times a second: they are drawn as they come, and what is beside them a few times a second.
const BESIDE_MS = 250;
const underWay = state => state.film && !state.over && !state.lost;
function adopt(state, number) { // one that was taken up again after its end is another file, or more of it: nothing of before is kept
  let known = scans[number]; if (known && known.state.taken_up !== state.taken_up) { known = null; frame = null; tell.events = ""; histogram.forget(); if (playing) play(); }
  scans[number] = Object.assign(known || {pictures: {}, frames: [], frameRates: [], frameSeen: []}, {state});
}
async function refresh(number) { // whether there is another picture
  const known = scans[number], state = known.state; let another = false;
  if (!known.plan && state.planned) {
    const p = await ask(`plan?scan=${number}`);
    if (p.places) { known.plan = {x: unpacked(p.x_m), y: unpacked(p.y_m), order: unpacked(p.order), wall: p.wall, grid: p.grid, start: p.start_ns, bin: p.bin_ns, window: p.window}; known.pitch = Math.sqrt(p.wall[0] * p.wall[1] / p.places); }
  }
  for (const m of state.methods) { const p = state.pictures[m]; if (p && (!known.pictures[m] || known.pictures[m].samples !== p.samples || (p.explained && !known.pictures[m].explained))) { const got = opened(await ask(`picture?scan=${number}&method=${m}`)); if (got) { known.pictures[m] = got; another = true; } } }
  return another;
}
async function refreshBeside(number) {
  const known = scans[number], state = known.state;
  if (state.samples && frame === null && (state.samples !== known.ratesOf || !known.rates || known.back)) { const r = await ask(`rates?scan=${number}`); known.back = false; if (r.rates_hz) { known.rates = unpacked(r.rates_hz); known.ratesOf = r.samples; } }
  if (state.over && known.frameVersion !== state.frames_version) for (let k = 0; k < state.frames.length; k++) if (state.frames[k] && (known.frameSeen[k] || "") !== state.frames[k] + "/" + (state.frames_version > k + state.frames.length)) {
    const p = opened(await ask(`picture?scan=${number}&frame=${k}`)); if (p) known.frames[k] = {...p, frame: k}; const r = await ask(`rates?scan=${number}&frame=${k}`); if (r.rates_hz) known.frameRates[k] = unpacked(r.rates_hz); known.frameSeen[k] = state.frames[k] + "/" + (state.frames_version > k + state.frames.length); }
  known.frameVersion = state.frames_version;
}
function arrange() {
  const view = document.body.dataset.view, wide = innerWidth, kinds = view !== "both" ? [view] : scans.length > 1 ? ["front"] : wide >= 1700 ? ["front", "depth", "turn"] : wide >= 1100 || wide <= 900 ? ["front", "depth"] : ["front"];
  const of = kind => scans.map((_, i) => [kind, i]), two = scans.length > 1, wanted = two ? of(kinds[0]) : kinds.map(kind => [kind, 0]);
  const against = two && compared && view !== "turn"; if (against) wanted.push([kinds[0] === "depth" ? "deeper" : "difference", 0]);
  const across = wanted.length; if (two && view === "both" && wide > 900) wanted.push(...of("depth"), ...(against ? [["deeper", 0]] : [])); $("views").style.setProperty("--across", across); $("views").parentElement.style.setProperty("--down", Math.ceil(wanted.length / across)); $("views").classList.toggle("first", !two && across === 3 && innerHeight >= 950); // the other two one above the other beside it
  const key = JSON.stringify(wanted); if (key === shape) return; shape = key;
  panels = wanted.map(([kind, scan]) => kind === "turn" ? new TurnPanel(scan) : new PicturePanel(kind, scan)); $("views").replaceChildren(...panels.map(p => p.box));
}
function draw() { readInks(); drawPictures(); drawBeside(); }
function drawPictures() {
  arrange(); const pictures = scans.map(best), span = depthSpan(pictures), pair = pictures.slice(0, 2), sameWall = pair.length > 1 && pair.every(p => p) && String(pair[0].wall) === String(pair[1].wall);
  const finest = sameWall && [0, 1].map(axis => Math.max(...pair.map(p => p.albedo.shape[axis]))), compare = sameWall && compared ? pair.map(p => onGrid(p, ...finest)) : [];
  const same = draw.span && Math.abs(draw.span[0] - span[0]) + Math.abs(draw.span[1] - span[1]) < 1e-9; if (!same) draw.span = span;
  for (const panel of panels) {
    const against = panel.kind === "difference" || panel.kind === "deeper", p = against ? compare[0] : pictures[panel.scan], name = {front: "Front view", depth: "Depth", turn: "3D", difference: "Difference", deeper: "Depth difference"}[panel.kind], state = scans[panel.scan].state;
    put(panel.title, scans.length > 1 ? (against ? `${name}: ${brief(scans[0].state.run)} less ${brief(scans[1].state.run)}` : `${brief(state.run)}: ${panel.kind === "turn" ? name : name.toLowerCase()}`) : name + (panel.kind === "turn" ? "" : ", looking towards the wall"));
    put(panel.empty, p ? "" : against && pictures.every(q => q) ? "these pictures are of walls of different sizes" : waitingFor(state)); panel.box.classList.toggle("old", !!panel.isOld && panel.isOld(p)); panel.draw(p, panel.kind === "front" ? [0, 1] : panel.kind === "deeper" && p ? deeperSpan(...compare) : draw.span, compare[1]);
  }
  const newest = pictures[0]; if (newest) document.body.dataset.picture = newest.samples, document.body.dataset.method = newest.method;
}
function drawBeside() {
  for (const known of scans) if (frame !== null && known.frameRates[stepOf(known)]) { known.rates = known.frameRates[stepOf(known)]; known.back = true; }
  map.draw(); histogram.draw(); put($("method").lastElementChild, method ? `${method.toUpperCase()} only` : "best picture");
}
function waitingFor(state) {
  if (state.status === "missing") return "no picture"; if (state.message) return state.message; const c = state.coming; if (frame !== null) return "this part of the scan is being reconstructed";
  if (state.status === "waiting") return "waiting for the scan to begin"; if (!c) return "no picture yet"; if (c.making) return `first picture is being made, of ${count(c.samples)} points`;
  return c.in_s === null ? `first picture at ${count(c.samples)} points` : `first picture in about ${seconds(c.in_s)}, at ${count(c.samples)} points`;
}
function next(state) {
  const c = state.coming; if (state.status === "missing") return ""; if (state.message) return state.message; if (!c || state.over) return ""; const what = Object.keys(state.pictures).length ? `${c.method.toUpperCase()} picture` : "first picture";
  return c.making ? `${what} of ${count(c.samples)} points is being made` : c.in_s === null ? "" : `${what} of ${count(c.samples)} points in about ${seconds(c.in_s)}`;
}
// Light: what it is called, and whether it is loud. What no program switches, or nobody commands any more, is loud as well.
const LIGHTS = {on: "LASER ON", off: "laser off", maybe: "LASER MAY BE ON", "no shutter": "NO SHUTTER: TREAT THE LASER AS ON", replayed: "replay of a recording: no laser", untold: "laser: this file does not say"};
const OVER = ["complete", "interrupted", "ended as asked", "stopped", "failed"], mayBeOn = state => ["on", "maybe", "no shutter"].includes(state.light);
function lightOf(state) { // its words, and whether they are loud
  const over = OVER.includes(state.status), simulated = state.simulated ? " (simulated bench)" : "";
  if (!state.light) return ["laser: not known" + (gone || state.status === "missing" ? "" : " before the scan begins"), false];
  if (gone && mayBeOn(state) && !over) return [LIGHTS.maybe + simulated, true];
  if (state.light === "off") return ["laser off" + (gone ? " when last seen" : over ? " since the scan's end" : "") + simulated, false];
  if (state.light === "no shutter" && over) return ["laser: not switched by this bench" + simulated, false];
  return [LIGHTS[state.light] + simulated, mayBeOn(state)];
}
function tellLight() { // of several scans the one whose light is on, else the one chosen
  const all = scans.map(s => s.state), state = [all[chosen], ...all].find(s => lightOf(s)[1]) || all[chosen], [text, lit] = lightOf(state);
  $("laser").hidden = false; $("laser").className = lit ? "lit" : ""; put($("laser"), whose(state) + text);
}
function words(state) { return state.status === "running" && state.light === "replayed" ? "Replaying a recording" : WORDS[state.status] || WORDS.waiting; }
const lightWords = state => state.light === "off" ? " The laser is off." : state.light === "no shutter" ? " This bench has no shutter: the laser is as it was." : mayBeOn(state) ? " The laser may be on." : "";
const resumes = state => "resumes the scan" + (state.light === "off" ? " and opens the shutter" : "");
// Recordings of before say "paused: Ctrl-C": bare, the keys read as if somebody were to press them.
const byWhom = text => text.replace(/^(ended while )?paused(: | by |$)/, "").replace(/^Ctrl-C$/, "Ctrl-C in the terminal");
function whyEnded(state) { // the last word on it before the status itself
  const said = (state.events.filter(e => e[1] === "scan" && e[2].startsWith("ended")).pop() || [0, "", ""])[2], signal = state.events.filter(e => e[1] === "signal").pop();
  if (said.startsWith("ended while paused")) { const paused = state.events.filter(e => e[1] === "scan" && e[2].startsWith("paused")).pop(), who = byWhom(said) || (paused ? byWhom(paused[2]) : ""); return `while paused${who ? ` by ${who}` : ""}: `; }
  return said ? said.replace(/^ended early: /, "") + ": " : signal ? `by ${signal[2]}: ` : "";
}
const soFar = state => count(state.samples) + (state.until_stopped ? "" : ` of ${count(state.planned)}`);
function banner(state) {
  const last = kind => (state.events.filter(e => e[1] === kind).pop() || [0, "", ""])[2], box = $("banner"), alarm = state.events.filter(e => e[1] === "alarm" || e[1] === "trip").pop(); let big = "", small = "", kind = "";
  const seen = state.planned ? `When last seen, at ${moment(seenAt)}: ${words(state).toLowerCase()}, ${soFar(state)} points. ` : "", under = !OVER.includes(state.status) && state.status !== "lost";
  if (gone) { const lit = lightOf(state)[1], ended = gone === "ended"; [big, small, kind] = [lit ? "The laser may still be on" : ended ? "The viewer has ended, or the way to it is cut" : "No answer from the viewer", (lit ? "Treat it as on and see the scan's terminal. " : "") + (ended ? lit ? "The viewer has ended, or the way to it is cut. " : "" : "The viewer is held up, or the way to it is cut. ") + "This page changes once it answers. " + seen + (under ? "The scan itself needs no viewer, and it alone commands the shutter" + (ended ? "; nlos live shows it again." : ".") : ended ? "Start nlos live again to see more." : ""), lit ? "bad" : ""]; }
  else if (state.status === "paused" && last("scan").startsWith("paused: alarm: ")) [big, small, kind] = ["Alarm: the scan is paused", last("scan").slice(15).replace(/\.?$/, ".") + lightWords(state) + ` Look for the cause first: pressing Enter in the scan's terminal ${resumes(state)}.`, "bad"];
  else if (state.status === "paused") { const who = byWhom(last("scan")); [big, small] = ["Paused", (who ? `by ${who}.` : "") + lightWords(state) + ` Pressing Enter there ${resumes(state)}.`]; }
  else if (state.status === "lost") [big, small, kind] = [mayBeOn(state) ? "The scan was killed: the laser may be on" : "The scan was killed; the laser was off", `Nobody commands the shutter now: look at the laser, then run \`nlos shutter close\`. ${count(state.samples)} samples are safe; \`nlos scan --resume\` takes the others.`, "bad"];
  else if (state.status === "missing") [big, small, kind] = [WORDS.missing, `${state.message.replace(/\.?$/, ".")} Nothing here knows whether the laser is on: see the scan's terminal.`, "bad"];
  else if (state.status === "unread") [big, small, kind] = [mayBeOn(state) ? "The laser may be on" : WORDS.unread, `For ${seconds(state.unread_s)} nothing of the scan's file could be read: its disk or network does not answer, or this computer is very busy. What is shown is of before.` + (mayBeOn(state) ? " Treat the laser as on and see the scan's terminal." : ""), "bad"];
  else if (state.status === "stopped" || state.status === "failed") [big, small, kind] = [WORDS[state.status], (state.status === "failed" && last("failed")) || last("trip") || last("alarm") || last("device"), "bad"];
  else if (state.status === "interrupted") [big, small] = ["Ended early", `${whyEnded(state)}${soFar(state)} points are taken; \`nlos scan --resume\` takes the others.`];
  else if (state.status === "ended as asked") [big, small, kind] = [WORDS[state.status], `the picture was good enough: ${soFar(state)} points are taken; \`nlos scan --resume\` takes the others.` + (state.over ? "" : " The last picture is being made."), "good"];
  else if (state.status === "complete") [big, small, kind] = ["Scan complete", `${count(state.samples)} points in ${seconds(state.elapsed_s)}` + (state.alarms ? `; ${state.alarms === 1 ? "one alarm" : count(state.alarms) + " alarms"}, see the events` : "") + (state.over ? "" : "; the last picture is being made"), "good"];
  else if (alarm && state.elapsed_s - alarm[0] < 30) [big, small, kind] = ["Alarm", `${alarm[2]} (at ${seconds(alarm[0])})`, "bad"];
  if (kind === "bad" && state.light && lightOf(state)[1] && (gone || ["paused", "lost", "unread"].includes(state.status))) kind = "bad lit"; // about light: no other trouble looks like it
  box.hidden = !big; box.className = kind; put(box.firstElementChild, big); put(box.lastElementChild, (big && state.run && !gone ? whose(state) : "") + small);
}
// A rate is of now only while points are being taken; else it says of when it is.
const counting = state => !gone && state.status === "running" && state.light !== "off";
function rateOf(state) { return counting(state) ? "count rate" : gone ? "count rate when last seen" : state.status === "paused" ? "count rate before the pause" : OVER.includes(state.status) ? "count rate at the end" : "last count rate"; }
function whose(state) { return scans.length > 1 ? `${brief(state.run)}: ` : ""; } // of several scans, figures and events are of the one clicked last
function tell() {
  const state = scans[chosen].state, p = best(scans[chosen]), noise = p && frame === null ? state.pictures[p.method] : p;
  put($("run"), scans.map(s => s.state.run).join(" and ")); const title = `${gone ? GONE[gone] : words(state)} - ${state.run}`; if (document.title !== title) document.title = title; put($("notes"), Object.entries(state.notes || {}).map(([name, text]) => `${name}: ${text}`).join(" · ")); put($("status"), gone ? GONE[gone] : whose(state) + words(state)); put($("next"), gone ? "" : next(state));
  put($("points"), soFar(state)); put($("rate"), state.rate_hz ? rate(state.rate_hz) : "–"); put($("rateof"), rateOf(state)); $("rate").className = counting(state) ? "" : "before";
  put($("noise"), noise ? `${(100 * noise.error).toFixed(1)} %, ${noise.error <= SETTLED ? "low" : "high"}` : "–"); put($("noiseof"), noise ? `photon noise of the picture of ${count(p.samples)} points` : "photon noise of the picture"); tellLight();
  put($("left"), state.status === "running" && state.left_s !== null && !gone ? `${seconds(state.left_s)} left` : state.elapsed_s ? `${seconds(state.elapsed_s)} taken` : "–"); $("done").style.width = state.until_stopped ? 0 : 100 * state.samples / (state.planned || 1) + "%";
  const film = state.film; $("film").hidden = !film; if (film) put($("film").lastElementChild, `${count(p && p.of_film ? p.of_film.frame + 1 : film.frame)}${film.frames ? ` of ${count(film.frames)}` : ""}` + (film.dropped ? `, ${count(film.dropped)} dropped` : ""));
  $("alarms").hidden = !state.alarms; put($("alarms").lastElementChild, state.alarms); banner(state); $("difference").hidden = scans.length < 2;
  const key = state.events.length + "/" + (state.events_before || 0); if (tell.events !== key + chosen) { tell.events = key + chosen; put($("earlier"), "newest first, " + (state.events_before ? `the last ${count(state.events.length)} of ${count(state.events.length + state.events_before)}` : `${count(state.events.length)} in all`));
    $("events").replaceChildren(...state.events.slice().reverse().map(e => { const tr = document.createElement("tr"); tr.className = e[1]; e.forEach((t, i) => { const td = document.createElement("td"); td.textContent = i ? t : fixed(t, 2) + " s"; tr.append(td); }); return tr; })); }
  tellSlider(scans[0]);
  $("overlay").setAttribute("aria-pressed", overlaid); $("difference").setAttribute("aria-pressed", compared);
}
const GONE = {ended: "No answer: the viewer has ended or is cut off", silent: "No answer"};
const moment = date => date.toDateString() === new Date().toDateString() ? date.toLocaleTimeString("en-GB") : date.toLocaleString("en-GB"); // a page may have slept for days
// Silence: an answer that is later than this is told to be missing; whoever comes back to the page waits for one no longer than that.
const SILENT_MS = 6_000, STATE_MS = 10_000, BACK_MS = 1_000, SIDE_MS = 1_000;
let seenAt = null; // when the viewer answered last, by this clock
let busy = false, missed = 0, timer = 0, besideAt = -Infinity, loading = null, heardMs = Date.now();
function silence(why) { gone = why; if (scans.length) { tell(); drawBeside(); } else { put($("status"), GONE[gone]); banner({events: []}); } }
async function tick() { // nothing is asked while nobody looks; whoever looks again is told at once
  clearTimeout(timer); if (busy || document.hidden) return; busy = true;
  try {
    const films = scans.some(s => underWay(s.state)), got = await ask(films ? `state?made=${scans.map(s => s.state.made)}` : "state", STATE_MS); if (!Array.isArray(got.scans) || !got.scans.length) throw Error(404); /* another program's, where ours was */ gone = ""; missed = 0; seenAt = new Date(); heardMs = Date.now();
    got.scans.forEach(adopt); if (!films || performance.now() - besideAt >= BESIDE_MS) tell(); // what it says comes before its pictures, and without them where they are long in coming
    loading = loading || load(films).catch(error => { if (!noAnswer(error)) throw error; }).finally(() => { loading = null; });
    await Promise.race([loading, new Promise(done => setTimeout(done, SIDE_MS))]);
  } catch (error) { if (!noAnswer(error)) throw error; if (++missed >= 3) silence(error instanceof DOMException ? "silent" : "ended"); }
  finally { busy = false; timer = setTimeout(tick, gone || (scans.length && scans.every(s => s.state.over && s.state.frames_version >= s.state.frames.length * s.state.methods.length)) ? 1500 : scans.some(s => underWay(s.state)) ? 5 : scans.some(s => s.state.coming && s.state.coming.making) ? 120 : 350); }
}
async function load(films) { // pictures and what is beside them
  let another = false; for (let i = 0; i < scans.length; i++) another = await refresh(i) || another;
  if (films && another) drawPictures();
  if (!films || performance.now() - besideAt >= BESIDE_MS) {
    besideAt = performance.now(); for (let i = 0; i < scans.length; i++) await refreshBeside(i);
    if (frame === null) await histogram.ask(); tell(); if (films && another) drawBeside(); else draw();
  }
}
function back() { if (!document.hidden) heardMs = Math.max(heardMs, Date.now() - SILENT_MS + BACK_MS); tick(); }
setInterval(() => { if (!gone && !document.hidden && Date.now() - heardMs > SILENT_MS) silence("silent"); }, 500);
function look(view) { document.body.dataset.view = view; for (const b of document.querySelectorAll("#tabs button[data-view]")) b.setAttribute("aria-pressed", b.dataset.view === view); draw(); }
function flip(name) { if (name === "overlay") overlaid = !overlaid; else compared = !compared; tell(); draw(); }
function other() { const names = scans[chosen].state.methods; method = method === null ? names[0] : names[names.indexOf(method) + 1] || null; tell(); draw(); }
function theme() { const root = document.documentElement, dark = matchMedia("(prefers-color-scheme: dark)").matches, now = root.dataset.theme || (dark ? "dark" : "light"); root.dataset.theme = now === "dark" ? "light" : "dark"; draw(); }
document.querySelectorAll("#tabs button[data-view]").forEach(b => b.addEventListener("click", () => look(b.dataset.view)));
for (const name of ["overlay", "difference"]) $(name).addEventListener("click", () => flip(name));
$("method").addEventListener("click", other); $("theme").addEventListener("click", theme);
$("help").addEventListener("click", () => $("keys").showModal()); $("closekeys").addEventListener("click", () => $("keys").close());
addEventListener("keydown", e => {
  if (e.ctrlKey || e.metaKey || e.altKey || $("keys").open) return; const views = {1: "front", 2: "depth", 3: "turn", 4: "both"};
  if (views[e.key]) look(views[e.key]); else if (e.key === "o") flip("overlay"); else if (e.key === "d" && scans.length > 1) flip("difference"); else if (e.key === "m") other(); else if (e.key === "v") showNext(); else if (e.key === "t") theme();
  else if (e.key === "l") $("scale").click(); else if (e.key === "?") $("keys").showModal(); else if (e.key === "Escape") { histogram.pinned = null; histogram.ask(); map.draw(); }
  else sliderKey(e);
});
const fitted = new ResizeObserver(() => { if (scans.length) draw(); }); for (const id of ["views", "map", "histo"]) fitted.observe($(id)); // a banner that comes or goes leaves them another size
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (scans.length) draw(); }); document.addEventListener("visibilitychange", back);
readInks(); tick();
