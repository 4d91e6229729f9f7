"use strict";
// The page round the scene. Whatever comes is shown as text, never as markup.

const byId = (id) => document.getElementById(id);
const ARMED = new Set(["REFERENCING", "PRETENSION", "HOLD", "ACTIVE"]);
const ALIVE_MS = 100;
let socket = null, hello = null, now = null, lab = null, plots = [], chosen = [], chosenPlot = null;
let operationShown = null, paused = false, seeking = false, watching = false, lastAlive = 0, number = 0;
const waiting = new Map();

function send(message) {
  if (!socket || socket.readyState !== WebSocket.OPEN) return false;
  socket.send(JSON.stringify(message));
  return true;
}

function ask(message, then) {
  number += 1;
  waiting.set(number, then);
  if (!send({ ...message, id: number })) then({ ok: false, error: "not sent: the connection is lost", next: "" });
}

function connect() {
  socket = new WebSocket(`ws://${location.host}/channel`);
  socket.onopen = () => { byId("link").textContent = ""; byId("link").classList.remove("lost"); };
  socket.onclose = () => {
    byId("link").textContent = "connection lost";
    byId("link").classList.add("lost");
    watching = false;
    setTimeout(connect, 1000);
  };
  socket.onmessage = (event) => receive(JSON.parse(event.data));
}

function receive(message) {
  if (message.kind === "hello") welcome(message);
  else if (message.kind === "now") { now = message; showNow(); }
  else if (message.kind === "points") addPoints(message);
  else if (message.kind === "events") message.events.forEach(addEvent);
  else if (message.kind === "ended") notice(`The run has ended. Watch it again: tonus view ${message.log}`);
  else if (message.kind === "reply") {
    const then = waiting.get(message.id);
    waiting.delete(message.id);
    if (then) then(message.reply);
  }
}

function notice(text) {
  byId("notice").textContent = text;
  byId("notice").hidden = !text;
}

function welcome(message) {
  hello = message;
  operationShown = null;
  byId("title").textContent = `Tonus: ${hello.runs.join(" and ")}`;
  document.title = `Tonus ${hello.runs[0]}`;
  notice(hello.damage.length ? `The log is not complete: ${hello.damage.join("; ")}` : "");
  byId("plots").replaceChildren();
  plots = hello.plots.map((each) => new Plot(byId("plots"), each, hello.window_s));
  const names = byId("signals");
  names.replaceChildren(...hello.signals.map((name) => {
    const option = document.createElement("option");
    option.value = name;
    return option;
  }));
  choose(chosen);
  byId("events").tBodies[0].replaceChildren();
  byId("marks").replaceChildren();
  hello.events.forEach(addEvent);
  byId("operation").hidden = byId("tests").hidden = !hello.asked;
  byId("estop").hidden = !hello.live;
  byId("estop").disabled = !hello.operate;
  if (!hello.operate) byId("estop").title = "This viewer only shows; start it with: tonus view --operate";
  byId("lab").hidden = !(hello.lab && hello.operate);
  if (hello.lab && hello.operate && !lab) lab = new LabPanel((request, then) => ask({ do: "lab", request }, then));
  byId("playback").hidden = hello.length_s === null;
  if (hello.length_s !== null) {
    byId("seek").max = Math.round(1000 * hello.length_s);
    byId("speed").replaceChildren(...hello.speeds.map((speed) => new Option(`${speed} x`, speed)));
  }
  scale();
}

function scale() {
  const canvas = byId("scale"), context = canvas.getContext("2d");
  const fill = context.createLinearGradient(0, 0, canvas.width, 0);
  hello.scale.colours.forEach((colour, k) => fill.addColorStop(k / 2, `rgb(${colour.join(",")})`));
  context.fillStyle = fill;
  context.fillRect(0, 0, canvas.width, canvas.height);
  const [slack, ...levels] = hello.scale.levels;
  byId("levels").textContent = ` cables: ${levels.join(", ")} N; black below ${slack} N`;
}

function showNow() {
  const run = now.runs ? now.runs[0] : null;
  if (run) {
    byId("state").textContent = now.runs.map((each) => each.state || "–").join(" | ");
    byId("state").className = `state ${run.state} ${ARMED.has(run.state) ? "armed" : ""}`;
    byId("meaning").textContent = run.stop ? `${run.meaning}: ${run.stop}` : `${run.meaning}${run.next ? `; next: ${run.next}` : ""}`;
    byId("grade").textContent = run.grade ? `envelope ${run.grade.toLowerCase()}${run.grade === "GREEN" ? "" : `, ${run.bound.toLowerCase()}`}` : "";
    byId("grade").className = `grade ${run.grade}`;
    const text = now.status && now.status.fault ? now.status.fault : run.fault ? run.fault.text : "";
    byId("fault").hidden = !run.fault;
    if (run.fault) byId("fault").textContent = `${text || run.fault.text}. What to do: ${run.fault.remedy}`;
  }
  byId("time").textContent = now.t === undefined ? "" : `${now.t.toFixed(2)} s`;
  if (hello && hello.length_s !== null) {
    byId("play").textContent = now.playing ? "Pause" : "Play";
    if (!seeking) byId("seek").value = Math.round(1000 * now.t);
    byId("speed").value = now.speed;
    byId("at").textContent = `${now.t.toFixed(2)} of ${hello.length_s.toFixed(1)} s`;
  }
  if (hello && hello.asked) showOperation();
}

// Only what is new: pictures come more often than statuses, and a page that is slow falls behind.
function showOperation() {
  const told = JSON.stringify([now.status, now.choices]);
  if (told === operationShown) return;
  operationShown = told;
  const status = now.status, verbs = byId("verbs");
  byId("tests").hidden = !status;
  if (!status) {
    verbs.textContent = "the daemon's control socket does not answer";
    return;
  }
  if (verbs.dataset.made !== "yes") {
    verbs.dataset.made = "yes";
    verbs.replaceChildren(...now.choices.filter((each) => each.verb !== "estop").map((each) => {
      const button = document.createElement("button");
      button.textContent = each.verb[0].toUpperCase() + each.verb.slice(1);
      button.dataset.verb = each.verb;
      button.onclick = () => command(each.verb);
      return button;
    }));
    byId("scenario").replaceChildren(...status.scenarios.map((name) => new Option(name, name)));
  }
  for (const each of now.choices) {
    const button = verbs.querySelector(`[data-verb=${each.verb}]`);
    if (!button) continue;
    const why = hello.operate ? each.why : "this viewer only shows; start it with: tonus view --operate";
    button.disabled = Boolean(why);
    button.title = why || each.about;
  }
  byId("scenario").disabled = !hello.operate || !status.served;
  if (document.activeElement !== byId("scenario")) byId("scenario").value = status.scenario;
  showTunable(status);
  const list = byId("selftest");
  list.replaceChildren(...status.self_test.map((each) => {
    const item = document.createElement("li");
    item.textContent = `${each.ok ? "✓" : "✗"} ${each.item}: ${each.text}`;
    item.className = each.ok ? "" : "bad";
    return item;
  }));
  if (!status.self_test.length) list.textContent = "not looked at while the robot is armed";
}

// A row for each parameter that may be changed: value in force, where it goes, and what to command.
function showTunable(status) {
  const body = byId("tunable").tBodies[0];
  byId("tuning").hidden = !status.tunable.length;
  if (body.rows.length !== status.tunable.length) {
    body.replaceChildren();
    for (const each of status.tunable) {
      const row = body.insertRow(), input = document.createElement("input"), button = document.createElement("button");
      row.insertCell().textContent = each.key.replace("control.", "");
      row.insertCell().className = "num";
      Object.assign(input, { type: "number", min: each.minimum, max: each.maximum, step: "any", value: each.target });
      input.title = `${each.minimum} to ${each.maximum}, at most ${each.step} at once, ${each.rate} a second`;
      input.setAttribute("aria-label", each.key);
      button.textContent = "Set";
      button.onclick = () => command("set", { key: each.key, value: input.value === "" ? "" : Number(input.value) });
      row.insertCell().append(input);
      row.insertCell().append(button);
    }
  }
  status.tunable.forEach((each, k) => {
    const row = body.rows[k], way = each.value === each.target ? "" : ` → ${each.target}`;
    row.cells[1].textContent = `${each.value.toFixed(3)}${way}`;
    row.querySelector("button").disabled = !hello.operate || !status.served;
  });
}

function command(verb, fields) {
  const watch = verb === "start" && byId("watch").checked;
  if (watch) watching = true;
  ask({ ...fields, do: "command", verb, watch }, (reply) => {
    const line = byId("reply");
    line.textContent = reply.ok ? `${reply.text}; next: ${reply.next}` : `refused: ${reply.error}${reply.next ? `; ${reply.next}` : ""}`;
    line.classList.toggle("refused", !reply.ok);
  });
}

function stopNow() {
  if (hello && hello.live && hello.operate) command("estop");
}

function addEvent(event) {
  const body = byId("events").tBodies[0];
  const row = body.insertRow(hello.live ? 0 : -1);
  row.className = event.level;
  const texts = [event.t.toFixed(3), event.level, event.name, event.where, event.text + (event.remedy ? `. What to do: ${event.remedy}` : "")];
  texts.forEach((text, k) => {
    const cell = row.insertCell();
    cell.textContent = text;
    if (!k) cell.className = "num";
  });
  while (body.rows.length > 500) body.deleteRow(hello.live ? -1 : 0);
  if (hello.length_s !== null) {
    row.onclick = () => send({ do: "seek", value: event.t });
    const mark = document.createElement("i");
    mark.className = event.level;
    mark.title = `${event.t.toFixed(2)} s ${event.name} ${event.text}`;
    mark.style.left = `${100 * event.t / hello.length_s}%`;
    mark.onclick = () => send({ do: "seek", value: event.t });
    byId("marks").append(mark);
  }
}

function addPoints(message) {
  if (!hello) return;
  message.runs.forEach((run, index) => {
    if (!run.t.length) return;
    plots.forEach((plot, k) => plot.add(index, run.t, run.plots[k], message.anew));
    if (chosenPlot && run.chosen.length === chosenPlot.told.series.length) chosenPlot.add(index, run.t, run.chosen, message.anew);
  });
  if (!paused) drawAll();
}

function drawAll() {
  plots.forEach((plot) => plot.draw());
  if (chosenPlot) chosenPlot.draw();
}

function choose(names) {
  chosen = names;
  if (chosenPlot) chosenPlot.box.remove();
  chosenPlot = chosen.length ? new Plot(byId("plots"), { title: "Chosen signals", unit: "", series: chosen, bounds: [] }, hello.window_s) : null;
  byId("chosen").replaceChildren(...chosen.map((name) => {
    const button = document.createElement("button");
    button.textContent = `${name} ✕`;
    button.onclick = () => choose(chosen.filter((each) => each !== name));
    return button;
  }));
  send({ do: "choose", signals: chosen });
}

// A sign of life with each picture drawn, so that a hidden or stalled page gives none.
function alive(time) {
  if (watching && time - lastAlive > ALIVE_MS) {
    lastAlive = time;
    send({ do: "alive" });
  }
  requestAnimationFrame(alive);
}

byId("estop").onclick = stopNow;
function onKey(event) { if (event.key === "Escape") { event.preventDefault(); stopNow(); } }
window.addEventListener("keydown", onKey, true);
byId("scene").addEventListener("load", () => byId("scene").contentWindow.addEventListener("keydown", onKey, true));
byId("play").onclick = () => send({ do: now && now.playing ? "pause" : "play" });
byId("speed").onchange = () => send({ do: "speed", value: Number(byId("speed").value) });
byId("seek").oninput = () => { seeking = true; send({ do: "seek", value: Number(byId("seek").value) / 1000 }); };
byId("seek").onchange = () => { seeking = false; };
byId("pause").onclick = () => { paused = !paused; byId("pause").textContent = paused ? "Go on" : "Pause plots"; if (!paused) drawAll(); };
byId("scenario").onchange = () => command("scenario", { name: byId("scenario").value });
byId("watch").onchange = () => { watching = byId("watch").checked && watching; send({ do: "watch", on: byId("watch").checked && watching }); };
byId("signal").onchange = () => {
  const name = byId("signal").value;
  if (hello && hello.signals.includes(name) && !chosen.includes(name)) choose([...chosen, name]);
  byId("signal").value = "";
};
window.addEventListener("resize", drawAll);
requestAnimationFrame(alive);
connect();
