// Asks for the newest update, which comes as soon as there is one, and draws it.
const MINUTE_S = 60, NEAR_NS = 1.2, STALE_S = 1.0, SILENT_S = 3.0;
let now = null, counts = null, trend = [], best = 0, log = true, has = 0, missed = 0, over = false, last_s = 0, heard_s = 0, paces = [];
const hz = (v, unit) => v === null || v === undefined || !Number.isFinite(v) ? "–" : v >= 1e6 ? (v / 1e6).toPrecision(4) + " M" + unit : v >= 1e3 ? (v / 1e3).toPrecision(4) + " k" + unit : v.toFixed(v < 100 ? 1 : 0) + " " + unit;
const signed = (v, digits) => (v < 0 ? "−" : "+") + Math.abs(v).toFixed(digits);
function say(id, text, wrong = false) { const box = $(id); if (box.textContent !== text) box.textContent = text; box.classList.toggle("wrong", wrong); }
function banner(big, small, kind) { const box = $("banner"); box.hidden = !big; box.className = kind || ""; box.firstElementChild.textContent = big || ""; box.lastElementChild.textContent = small || ""; }
function take(update) {
  has = update.number; const at_s = performance.now() / 1e3; last_s = at_s;
  if (update.over !== undefined) { over = true; banner(...update.over); stale("no longer measured"); return; }
  now = update; if (update.counts) { counts = unpacked(update.counts); now.counts = null; }
  paces.push(at_s); while (paces.length > 1 && at_s - paces[0] > 3) paces.shift();
  if (update.detector_hz !== undefined) { trend.push([at_s, update.detector_hz, update.direct_hz]); while (trend.length && at_s - trend[0][0] > MINUTE_S) trend.shift(); best = Math.max(best, update.direct_hz || 0); }
  document.body.classList.remove("stale"); banner(""); tell(); draw(at_s);
}
function tell() {
  const u = now; say("bench", u.heading[0]); document.title = (u.lit ? "LIGHT ON - " : "") + u.heading[0];
  say("light", u.light); $("light").classList.toggle("on", u.lit);
  say("pace", paces.length > 4 ? `${((paces.length - 1) / (paces[paces.length - 1] - paces[0])).toFixed(1)} updates a second` : "");
  say("detector", hz(u.detector_hz, "counts/s")); say("load", u.detector_hz === undefined ? "" : `${(100 * u.detector_hz / u.stated_hz).toFixed(2)} % of the pulses`, u.detector_hz > .05 * u.stated_hz);
  const seen = typeof u.direct_ns === "number"; say("direct", seen ? hz(u.direct_hz, "counts/s") : "no peak"); say("best", best ? `best since cleared ${hz(best, "counts/s")}` : "");
  say("fwhm", seen && u.direct_fwhm_ps ? `${u.direct_fwhm_ps.toFixed(0)} ps` : "–"); say("at", seen ? `at ${u.direct_ns.toFixed(3)} ns` : "");
  const off = u.sync_hz !== undefined && !(Math.abs(u.sync_hz / u.stated_hz - 1) < .01); say("sync", hz(u.sync_hz, "Hz")); say("stated", off ? `the bench file says ${hz(u.stated_hz, "Hz")}` : "", off);
  $("beam").hidden = u.x_m === undefined; if (u.x_m !== undefined) { say("place", `${signed(u.x_m, 3)} ${signed(u.y_m, 3)} m`); say("angles", `sent to ${signed(u.x_deg, 3)} ${signed(u.y_deg, 3)} deg, optical`); }
  say("notes", [...u.heading.slice(1), ...u.notes].join("\n"));
}
function draw(at_s = performance.now() / 1e3) {
  readInks(); $("scale").lastElementChild.textContent = log ? "log" : "linear"; if (!now) return;
  if (counts) {
    const end = now.start_ns + counts.length * now.bin_ns, mark = typeof now.direct_ns === "number" ? now.direct_ns : null; let most = 0; for (const c of counts) most = Math.max(most, c);
    bars($("whole"), counts, now.start_ns, now.bin_ns, now.start_ns, end, log, mark); say("over", `${now.summed_s.toFixed(1)} s in bins of ${Number((1e3 * now.bin_ns).toPrecision(4))} ps, highest ${count(most)}`);
    if (mark !== null) { const [from, to] = [mark - NEAR_NS, mark + NEAR_NS]; bars($("peak"), counts, now.start_ns, now.bin_ns, from, to, false, mark); say("near", ""); if (now.direct_fwhm_ps) widthMark($("peak"), from, to, mark, now.direct_fwhm_ps / 1e3); } else { pen($("peak")); say("near", "none in what is looked at"); }
  }
  lines($("trend"), trend.map(r => [at_s - r[0], r[1], r[2]]), MINUTE_S);
}
const lastLit = () => !over && !!now && now.lit; // who hangs, or is no longer heard, may have left it on
function stale(why) {
  const lit = lastLit(); document.body.classList.add("stale"); say("light", (lit ? "LIGHT MAY BE ON: " : "") + why); $("light").classList.toggle("on", lit);
  say("pace", ""); document.title = (lit ? "LIGHT MAY BE ON - " : "") + "nlos monitor: " + why;
}
const treatAsOn = () => lastLit() ? "The light was on when last seen: treat it as on. " : "";
async function follow() {
  while (!over) {
    if (document.hidden) { await new Promise(done => document.addEventListener("visibilitychange", done, {once: true})); continue; }
    try { const got = await ask("newest?has=" + has); missed = 0; heard_s = Date.now() / 1e3; if (got.number) take(got); }
    catch (error) { if (!noAnswer(error)) throw error; if (++missed >= 3) untold(); await new Promise(done => setTimeout(done, 500)); }
  }
}
function untold() { stale("no answer"); banner("The page is no longer told", treatAsOn() + "Look at the terminal: the program there continues without this page, or has ended.", "bad"); }
setInterval(() => {
  if (over || !now || missed) return;
  if (!document.hidden && Date.now() / 1e3 - heard_s > SILENT_S) untold(); // whatever the program does, its page answers within a tenth of a second
  else if (performance.now() / 1e3 - last_s > STALE_S) { stale("no update"); banner("No update", treatAsOn() + "The program waits, for an answer at its terminal or for an instrument. What is shown is old.", lastLit() ? "bad" : ""); }
}, 250);
document.addEventListener("visibilitychange", () => { if (!document.hidden) heard_s = Math.max(heard_s, Date.now() / 1e3 - SILENT_S + STALE_S); });
const flips = {l: () => { log = !log; draw(); }, c: () => { trend = []; best = 0; draw(); }, t: () => { const root = document.documentElement, dark = (root.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark"; root.dataset.theme = dark ? "light" : "dark"; draw(); }};
for (const [id, key] of [["scale", "l"], ["clear", "c"], ["theme", "t"]]) $(id).addEventListener("click", flips[key]);
addEventListener("keydown", e => { if (!(e.ctrlKey || e.metaKey || e.altKey) && flips[e.key]) flips[e.key](); });
addEventListener("resize", () => draw()); follow();
