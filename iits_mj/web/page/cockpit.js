// Instruments over the scene, and driving by keyboard or gamepad. Talks to iits_mj/web/server.py.
"use strict";
(() => {
  const PERIOD = 50; // between two messages of a driver [ms]
  const keys = new Set();
  let socket, number = 0, state = {}, reverse = false, retarder = 0, over = "", pressed = [];

  const make = (tag, name, parent, text = "") => {
    const element = document.createElement(tag);
    element.className = name;
    element.textContent = text;
    parent.append(element);
    return element;
  };
  const root = document.createElement("section");
  root.id = "iits";
  root.setAttribute("aria-label", "instruments");
  const banner = make("div", "banner", root);
  banner.setAttribute("role", "status");
  banner.hidden = true;
  const dash = make("div", "dash", root);
  const main = make("div", "main", dash);
  const speed = make("b", "speed", main, "–");
  make("span", "unit", main, "km/h");
  const wanted = make("span", "wanted", main);
  const gear = make("b", "gear", main, "–");
  const bars = make("div", "bars", dash);
  const bar = {};
  for (const [key, label] of [["engine", "engine"], ["pedal", "pedal"], ["brake", "brake"], ["retarder", "retarder"]]) {
    const row = make("div", `bar ${key}`, bars);
    make("span", "label", row, label);
    bar[key] = make("i", "", make("span", "track", row));
    bar[`${key}Text`] = make("span", "value", row, "–");
  }
  const list = make("dl", "list", dash);
  const choice = make("div", "choice", dash);
  const controls = make("div", "controls", dash);
  const drive = make("button", "", controls, "Drive yourself");
  const pause = make("button", "", controls, "Pause");
  const line = make("label", "timeline", dash);
  const place = make("input", "", line);
  const clock = make("span", "value", line);
  place.type = "range";
  place.min = 0;
  place.step = 0.1;
  place.setAttribute("aria-label", "time of the drive [s]");
  place.oninput = () => send({ seek: Number(place.value) });
  const help = make("div", "help", root, "");
  help.hidden = true;

  const send = (message) => {
    if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
  };
  const driving = () => number > 0 && state.holder === number;
  const fill = (key, share, text) => {
    bar[key].style.width = `${Math.round(100 * Math.max(0, Math.min(1, share)))}%`;
    bar[`${key}Text`].textContent = text;
  };

  function show(next) {
    state = next;
    dash.hidden = !next.speed;
    speed.textContent = next.speed ?? "–";
    wanted.textContent = next.wanted ?? "";
    gear.textContent = next.gear ?? "–";
    for (const key of ["engine", "pedal", "brake", "retarder"]) {
      const value = next[key];
      bar[key].parentElement.parentElement.hidden = !value;
      if (value) fill(key, value[0], value[1]);
    }
    list.replaceChildren();
    for (const [name, value] of next.rows || []) {
      const row = make("div", "", list);
      make("dt", "", row, name);
      make("dd", "", row, value);
    }
    choice.replaceChildren();
    for (const [name, value, taken] of next.choice || []) {
      const item = make("span", taken ? "taken" : "", choice);
      make("b", "", item, name);
      make("i", "", item, value);
    }
    choice.hidden = !(next.choice || []).length;
    line.hidden = !next.timeline;
    if (next.timeline) {
      const [now, end] = next.timeline;
      place.max = end;
      if (document.activeElement !== place || !place.matches(":active")) place.value = now;
      clock.textContent = `${now.toFixed(1)} of ${end.toFixed(1)} s`;
    }
    drive.hidden = !next.manual;
    drive.textContent = driving() ? "Release the wheel" : "Drive yourself";
    drive.disabled = Boolean(next.holder) && !driving();
    pause.textContent = next.paused ? "Resume" : "Pause";
    help.hidden = !driving();
    if (driving()) {
      help.textContent = "↑ W accelerate · ↓ S brake · ← → A D steer · Q E retarder " +
        `${Math.round(100 * retarder)} % · R ${reverse ? "reverse" : "forward"} (standing) · Esc release`;
    }
    say(next.message, next.level);
  }

  function say(text, level = "info") {
    if (over) return;
    if (level === "error") over = text;
    banner.hidden = !text;
    banner.textContent = text || "";
    banner.dataset.level = level;
  }

  function connect() {
    const address = location.href.split(/[?#]/)[0].replace(/^http/, "ws").replace(/\/?$/, "/cockpit");
    socket = new WebSocket(address);
    socket.onmessage = (event) => {
      const { kind, content } = JSON.parse(event.data);
      if (kind === "page") { number = content; over = ""; say(""); }
      else if (kind === "state") show(content);
      else if (kind === "error") say(content, "error");
    };
    socket.onclose = () => {
      number = 0;
      say("The connection to the simulation is lost.", "warning");
      setTimeout(connect, 1000);
    };
  }

  // The first gamepad: left stick, right trigger accelerates, left trigger brakes.
  function gamepad() {
    const pad = [...(navigator.getGamepads ? navigator.getGamepads() : [])].find(Boolean);
    if (!pad) return { steer: 0, pedal: 0, brake: 0 };
    const button = (i) => (pad.buttons[i] ? pad.buttons[i].value : 0);
    const once = (i, act) => {
      const down = button(i) > 0.5;
      if (down && !pressed[i]) act();
      pressed[i] = down;
    };
    once(3, () => { reverse = !reverse; });
    once(4, () => { retarder = Math.max(0, retarder - 0.25); });
    once(5, () => { retarder = Math.min(1, retarder + 0.25); });
    once(1, () => send({ release: true }));
    const stick = pad.axes[0] || 0;
    return { steer: Math.abs(stick) < 0.08 ? 0 : -stick, pedal: button(7), brake: button(6) };
  }

  const held = (...names) => (names.some((name) => keys.has(name)) ? 1 : 0);
  setInterval(() => {
    if (!driving()) return;
    const pad = gamepad();
    const hands = {
      pedal: Math.max(held("ArrowUp", "KeyW"), pad.pedal),
      brake: Math.max(held("ArrowDown", "KeyS"), pad.brake),
      steer: held("ArrowLeft", "KeyA") - held("ArrowRight", "KeyD") || pad.steer,
      retarder, reverse,
    };
    send({ hands });
  }, PERIOD);

  const DRIVING = new Set(["ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight", "KeyW", "KeyA", "KeyS",
    "KeyD", "KeyQ", "KeyE", "KeyR", "Escape"]);
  const typing = (event) => /^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName || "");
  function onKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || typing(event)) return;
    const down = event.type === "keydown";
    if (event.code === "Space" && event.target.tagName !== "BUTTON") {
      if (down && !event.repeat) send({ request: "pause" });
    } else if (driving() && DRIVING.has(event.code)) {
      if (down && !event.repeat) {
        if (event.code === "KeyQ") retarder = Math.max(0, retarder - 0.25);
        if (event.code === "KeyE") retarder = Math.min(1, retarder + 0.25);
        if (event.code === "KeyR") reverse = !reverse;
        if (event.code === "Escape") send({ release: true });
      }
      if (down) keys.add(event.code); else keys.delete(event.code);
    } else return;
    event.preventDefault();
    event.stopImmediatePropagation(); // viser moves its camera by the same keys
  }
  window.addEventListener("keydown", onKey, true);
  window.addEventListener("keyup", onKey, true);
  window.addEventListener("blur", () => keys.clear());
  drive.onclick = () => {
    keys.clear();
    reverse = false;
    retarder = 0;
    send(driving() ? { release: true } : { take: true });
    drive.blur();
  };
  pause.onclick = () => { send({ request: "pause" }); pause.blur(); };

  document.addEventListener("DOMContentLoaded", () => document.body.append(root));
  if (document.body) document.body.append(root);
  dash.hidden = true;
  connect();
  // viser adds the address of its websocket; it is that of the page.
  setInterval(() => {
    if (location.search) history.replaceState(null, "", location.pathname);
  }, 1000);
})();
