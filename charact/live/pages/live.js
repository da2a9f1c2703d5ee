"use strict";
// The page only looks: it shows what the stream of events brings, and asks for nothing else.

const at = (id) => document.getElementById(id);
const HISTORY_S = 60;
const STALE_S = 1.5;
const history = [];
const arrivals = [];
let lastFocus = null;
let loading = false;
let nextPicture = null;

const digits = (value, significant = 4) => Number(value.toPrecision(significant)).toString();
const thousands = (value) => value.toLocaleString("en");
const show = (id, text) => { at(id).textContent = text; };
const count = (what) => { document.body.dataset[what] = Number(document.body.dataset[what]) + 1; };
const colour = (name) => getComputedStyle(document.body).getPropertyValue(name).trim();
const UNITS = { exposure_s: [1e3, "exposure", "ms"], mcp_v: [1, "plate", "V"], gate_ns: [1e-3, "gate", "µs"],
  illuminance_lux: [1, "light", "lux"], camera_gain_db: [1, "camera gain", "dB"], temperature_c: [1, "temperature", "°C"] };

// One image is requested at a time, the next after its arrival: a busy machine shows fewer, never none.
function showPicture(number) {
  if (loading) { nextPicture = number; return; }
  loading = true;
  at("picture").src = `/picture.jpg?number=${number}`;
}

function pictureDone() {
  const number = nextPicture;
  loading = false;
  nextPicture = null;
  if (number !== null) showPicture(number);
}

function showMeters(view) {
  const [rows, columns] = view.rows_columns;
  const share = 100 * view.saturated_px / view.pixels;
  show("saturated", `${thousands(view.saturated_px)} of ${thousands(view.pixels)} px (${digits(share, 3)} %) at or above ${view.full_scale_dn} DN`);
  at("saturated-box").classList.toggle("alarm", view.saturated_px > 0);
  show("mean", `${digits(view.mean_dn)} DN`);
  const error = view.noise_se_dn === null ? "" : ` ± ${digits(view.noise_se_dn, 2)}`;
  show("noise", view.noise_dn === null ? "needs two frames" : `${digits(view.noise_dn)}${error} DN`);
  show("highest", `${view.highest_dn} DN`);
  show("rate", view.frame_rate_hz === null ? "needs two frames" : `${view.frame_rate_hz.toFixed(2)} Hz`);
  show("lost", `${thousands(view.lost_frames)} frames`);
  at("lost-box").classList.toggle("alarm", view.lost_frames > 0);
  const known = Object.entries(UNITS).filter(([name]) => view.conditions[name] !== undefined);
  show("conditions", known.map(([name, [scale, word, unit]]) =>
    `${word} ${digits(view.conditions[name] * scale)} ${unit}`).join(", ") || "nothing");
  const thinned = view.step > 1 ? `, one pixel in ${view.step} × ${view.step}` : "";
  show("legend", `${rows} rows × ${columns} columns${thinned}; black ${view.black_dn} DN, white ${view.white_dn} DN; ` +
    "saturated pixels are marked blue (black in red light)");
  show("state", `${view.of}, frame ${view.frame}`);
  count("meters");
}

function showFocus(view) {
  const focus = view.focus, best = view.best;
  if (focus === null) { show("focus-note", "not read yet"); return; }
  const known = focus.mtf50_cy_per_px !== null;
  show("mtf50", known ? focus.mtf50_cy_per_px.toFixed(4) : "–");
  show("interval", known ? `95 %: ${focus.interval95.map((end) => end.toFixed(4)).join(" to ")} cy/px` : "");
  const flags = focus.flags.length ? `flags: ${focus.flags.join(", ")}; ` : "";
  const where = focus.region ? `region ${focus.region.join(",")} px, ` : "";
  show("focus-note", known ? `${flags}${where}read in ${(1e3 * focus.seconds).toFixed(0)} ms` : focus.reason);
  if (best === null) { show("best", "best so far: –"); } else {
    const reached = view.at_best ? " — reached" : "";
    show("best", `best so far: ${best.mtf50_cy_per_px.toFixed(4)} cy/px${reached}`);
  }
  const percent = known && best ? Math.min(100, 100 * focus.mtf50_cy_per_px / best.mtf50_cy_per_px) : 0;
  at("focus-bar").style.width = `${percent}%`;
  at("focus-meter").setAttribute("aria-valuenow", percent.toFixed(0));
  const key = JSON.stringify([focus.mtf50_cy_per_px, focus.seconds]);
  if (known && key !== lastFocus) {
    lastFocus = key;
    history.push({ t: performance.now() / 1e3, value: focus.mtf50_cy_per_px, ends: focus.interval95 });
  }
  drawHistory(best);
}

function showRegion(view) {
  const region = view.region ?? (view.focus && view.focus.region);
  const box = at("region"), [rows, columns] = view.rows_columns;
  box.hidden = !region;
  if (!region) return;
  const [row, col, height, width] = region;
  box.style.top = `${100 * row / rows}%`;
  box.style.left = `${100 * col / columns}%`;
  box.style.height = `${100 * height / rows}%`;
  box.style.width = `${100 * width / columns}%`;
}

function cleared(id) {
  const canvas = at(id), pen = canvas.getContext("2d");
  canvas.width = canvas.clientWidth;
  canvas.height = canvas.clientHeight;
  pen.font = "13px system-ui, sans-serif";
  return [pen, canvas.width, canvas.height];
}

function drawHistogram(view) {
  const [pen, width, height] = cleared("histogram");
  const floor = height - 20, left = 60, top = Math.log10(view.pixels);
  const step = (width - left) / view.histogram.length;
  pen.fillStyle = colour("--mark");
  view.histogram.forEach((pixels, bin) => {
    if (pixels === 0) return;
    const tall = Math.max(2, floor * Math.log10(pixels + 1) / top);
    pen.fillRect(left + bin * step, floor - tall, Math.max(step - 0.5, 1), tall);
  });
  if (view.saturated_px > 0) {
    pen.fillStyle = colour("--alarm");
    const tall = Math.max(2, floor * Math.log10(view.saturated_px + 1) / top);
    pen.fillRect(width - Math.max(step, 4), floor - tall, Math.max(step, 4), tall);
  }
  pen.fillStyle = colour("--faint");
  for (let power = 0; power <= top; power += 2) pen.fillText(`${thousands(10 ** power)} px`, 0, Math.max(12, floor - floor * power / top + 4));
  const end = view.histogram.length * view.bin_dn;
  for (let quarter = 0; quarter <= 4; quarter++) {
    pen.textAlign = quarter === 4 ? "right" : quarter ? "center" : "left";
    const code = quarter === 4 ? view.full_scale_dn : Math.round(end * quarter / 4);
    pen.fillText(`${code} DN`, left + (width - left) * quarter / 4, height - 4);
  }
  pen.textAlign = "left";
  count("histograms");
}

function drawHistory(best) {
  const [pen, width, height] = cleared("history");
  const now = performance.now() / 1e3, left = 44, floor = height - 20;
  while (history.length && now - history[0].t > HISTORY_S) history.shift();
  const highest = 1.15 * Math.max(best ? best.mtf50_cy_per_px : 0, ...history.map((one) => one.value), 1e-3);
  const x = (t) => width - (width - left) * (now - t) / HISTORY_S;
  const y = (value) => floor * (1 - Math.min(value / highest, 1));
  pen.fillStyle = colour("--faint");
  [0, 0.5, 1].forEach((share) => pen.fillText((highest * share).toFixed(3), 0, Math.max(12, y(highest * share))));
  pen.fillText(`${HISTORY_S} s ago`, left, height - 4);
  pen.textAlign = "right"; pen.fillText("now", width, height - 4); pen.textAlign = "left";
  if (best) {
    pen.strokeStyle = colour("--faint"); pen.setLineDash([6, 4]);
    pen.beginPath(); pen.moveTo(left, y(best.mtf50_cy_per_px)); pen.lineTo(width, y(best.mtf50_cy_per_px)); pen.stroke();
    pen.setLineDash([]);
  }
  pen.strokeStyle = pen.fillStyle = colour("--mark");
  for (const one of history) {
    pen.globalAlpha = 0.35;
    pen.beginPath(); pen.moveTo(x(one.t), y(one.ends[0])); pen.lineTo(x(one.t), y(one.ends[1])); pen.stroke();
    pen.globalAlpha = 1;
    pen.fillRect(x(one.t) - 1.5, y(one.value) - 1.5, 3, 3);
  }
}

function showPageRate() {
  const now = performance.now() / 1e3;
  while (arrivals.length && now - arrivals[0] > 2) arrivals.shift();
  show("page-rate", `${(arrivals.length / 2).toFixed(1)} updates/s`);
  const silent = arrivals.length === 0 || now - arrivals[arrivals.length - 1] > STALE_S;
  document.body.classList.toggle("stale", silent);
}

function take(message) {
  const view = JSON.parse(message.data);
  arrivals.push(performance.now() / 1e3);
  showPicture(view.number);
  showMeters(view);
  drawHistogram(view);
  showFocus(view);
  showRegion(view);
}

function press(id, className) {
  const pressed = document.body.classList.toggle(className);
  at(id).setAttribute("aria-pressed", String(pressed));
}

at("picture").addEventListener("load", () => { count("pictures"); pictureDone(); });
at("picture").addEventListener("error", pictureDone);
at("red").addEventListener("click", () => press("red", "red"));
at("large").addEventListener("click", () => press("large", "large"));
at("forget").addEventListener("click", () => fetch("/best/forget", { method: "POST" }));
setInterval(showPageRate, 250);

const stream = new EventSource("/events");
stream.addEventListener("about", (message) => {
  const about = JSON.parse(message.data);
  show("title", about.title);
  document.title = about.title;
  if (about.focus_first && !document.body.classList.contains("large")) press("large", "large");
});
stream.addEventListener("view", take);
stream.addEventListener("ended", (message) => {
  stream.close();
  show("state", `ended: ${JSON.parse(message.data).why}`);
});
stream.addEventListener("error", () => show("state", "no connection to charact: is it still running?"));
