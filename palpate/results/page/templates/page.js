"use strict";

/* Page of a clip: curves under a cursor that goes with the video. */
function showCurves(data) {
  const box = document.getElementById("curves"), now = document.getElementById("now");
  const video = document.getElementById("video");
  const times = data.time_s, last = times.length - 1;
  const left = 60, right = 14;
  let current = 0, width = 0, cursors = [];
  if (last < 0) return;
  const ends = times.map((time, index) => index < last ? times[index + 1] : time + 1 / data.fps);
  const begin = times[0], end = ends[last];
  const x = time => left + (time - begin) / (end - begin) * (width - left - right);

  const add = (parent, name, attributes, text) => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const key in attributes) element.setAttribute(key, attributes[key]);
    if (text !== undefined) element.textContent = text;
    parent.append(element);
    return element;
  };
  const digits = value => Number(value.toPrecision(3)).toString();
  const ticks = (low, high, count) => {
    const raw = (high - low) / count, size = 10 ** Math.floor(Math.log10(raw));
    const step = size * [1, 2, 5, 10].find(factor => size * factor >= raw);
    const found = [];
    for (let at = Math.ceil(low / step); at * step <= high * (1 + 1e-9); at++) found.push(at * step);
    return found;
  };
  const panel = (height, title) => {
    const head = document.createElement("p");
    head.className = "title";
    head.textContent = title;
    box.append(head);
    return add(box, "svg", {width, height, viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true"});
  };
  const finish = (svg, top, bottom) => cursors.push(add(svg, "line", {class: "cursor", y1: top, y2: bottom}));

  /* Pieces hold from one time to the next: begin, end, value, low, high (null: none), and whether they are sure. */
  const draw = (kind, title, pieces) => {
    const height = 165, top = 6, bottom = height - 8, svg = panel(height, title);
    let low = 0, high = 0;
    for (const piece of pieces) {  // a hundredfold interval would flatten the rest
      low = Math.min(low, piece.value, Math.max(piece.low ?? piece.value, -5 * Math.abs(piece.value)));
      high = Math.max(high, piece.value, Math.min(piece.high ?? piece.value, 5 * Math.abs(piece.value)));
    }
    high += 0.05 * (high - low) || 1;
    const y = value => bottom - (Math.min(Math.max(value, low), high) - low) / (high - low) * (bottom - top);
    for (const tick of ticks(low, high, 4)) {
      add(svg, "line", {class: "grid", x1: left, x2: width - right, y1: y(tick), y2: y(tick)});
      add(svg, "text", {x: left - 6, y: y(tick) + 4, "text-anchor": "end"}, digits(tick));
    }
    const group = add(svg, "g", {class: kind});
    const runs = [];
    for (const piece of pieces) {
      const run = runs[runs.length - 1], before = run && run[run.length - 1];
      if (before && before.sure === piece.sure && Math.abs(before.end - piece.begin) < 1e-6) run.push(piece);
      else runs.push([piece]);
    }
    for (const run of runs) {
      const unsure = run[0].sure ? "" : " unsure";
      const steps = (name, list) => list.map(piece => [[piece.begin, piece[name]], [piece.end, piece[name]]]).flat();
      const points = list => list.map(([time, value]) => x(time).toFixed(1) + "," + y(value).toFixed(1)).join(" ");
      const ranged = run.filter(piece => piece.low !== null && piece.high !== null);
      if (ranged.length) add(group, "polygon", {class: "interval" + unsure, points: points([...steps("high", ranged), ...steps("low", ranged).reverse()])});
      add(group, "polyline", {class: "value" + unsure, points: points(steps("value", run))});
    }
    finish(svg, top, bottom);
  };
  const band = (title, coded, prefix) => {
    const svg = panel(26, title);
    for (let index = 0; index <= last; index++) {
      const code = coded.index[index], from = index;
      while (index < last && coded.index[index + 1] === code) index++;
      const place = {x: x(times[from]), width: Math.max(x(ends[index]) - x(times[from]), 1), y: 2, height: 22};
      add(add(svg, "rect", {...place, class: "band " + prefix + coded.names[code]}), "title", {}, coded.words[code]);
    }
    finish(svg, 0, 26);
  };
  const axis = () => {
    const svg = panel(34, "");
    for (const tick of ticks(begin, end, Math.max(2, width / 90))) add(svg, "text", {x: x(tick), y: 12, "text-anchor": "middle"}, digits(tick));
    add(svg, "text", {x: (left + width - right) / 2, y: 30, "text-anchor": "middle"}, "time [s]");
  };

  const forcePieces = contact => contact.time_s.map((time, index) => ({
    begin: time, end: time + contact.frame_s[index], value: contact.force[index],
    low: contact.force_low[index], high: contact.force_high[index], sure: true,
  })).filter(piece => piece.value !== null);
  const framePieces = times.map((time, index) => ({
    begin: time, end: ends[index], value: data.stiffness[index], low: data.stiffness_low[index],
    high: data.stiffness_high[index], sure: data.sure[index],
  })).filter(piece => piece.value !== null);
  const runPieces = data.contacts.filter(contact => contact.stiffness !== null && contact.time_s.length).map(contact => ({
    begin: contact.time_s[0], end: contact.time_s[contact.time_s.length - 1] + contact.frame_s[contact.frame_s.length - 1],
    value: contact.stiffness, low: contact.stiffness_low, high: contact.stiffness_high, sure: contact.sure,
  }));

  const drawAll = () => {
    if (box.clientWidth === width) return;
    width = box.clientWidth;
    cursors = [];
    box.replaceChildren();
    const units = [...new Set(data.contacts.map(contact => contact.unit).filter(unit => unit))];
    for (const unit of units) draw("force", "force, " + unit, data.contacts.filter(contact => contact.unit === unit).flatMap(forcePieces));
    if (runPieces.length) draw("stiffness", "stiffness by contact, " + data.unit, runPieces);
    if (framePieces.length) draw("stiffness", "stiffness by frame, " + data.unit, framePieces);
    band("verdict of the frame, or its status", data.state, "v-");
    if (data.alarm) band("alarm of the force limit", data.alarm, "a-");
    axis();
    move(current);
  };

  const ranged = (value, low, high) => digits(value) + (low === null || high === null ? "" : ` (${digits(low)} to ${digits(high)})`);
  const told = index => {
    const parts = [`frame ${data.frame[index]}, ${times[index].toFixed(2)} s: ${data.state.words[data.state.index[index]]}`];
    for (const contact of data.contacts) {
      const at = contact.time_s.findIndex(time => Math.abs(time - times[index]) < 1e-6);
      if (at < 0) continue;
      const force = contact.force[at];
      parts.push("contact: " + contact.name.replaceAll("_", " "));
      parts.push(force === null ? "force unknown" : `force ${ranged(force, contact.force_low[at], contact.force_high[at])} ${contact.unit}`);
    }
    const value = data.stiffness[index];
    if (value !== null) parts.push(`stiffness ${ranged(value, data.stiffness_low[index], data.stiffness_high[index])} ${data.sure[index] ? "" : "(not determined) "}${data.unit}`);
    if (data.alarm && data.alarm.names[data.alarm.index[index]]) parts.push("alarm: " + data.alarm.names[data.alarm.index[index]]);
    const detail = data.detail.names[data.detail.index[index]];
    return parts.join("; ") + (detail ? ". " + detail : "");
  };
  const move = index => {
    current = Math.min(Math.max(index, 0), last);
    const at = x(times[current]);
    for (const cursor of cursors) { cursor.setAttribute("x1", at); cursor.setAttribute("x2", at); }
    now.textContent = told(current);
    box.setAttribute("aria-valuenow", current);
    box.setAttribute("aria-valuetext", now.textContent);
  };
  /* The overlay's frames are evenly spaced, whatever the clip's time stamps: the middle of a frame's time shows it. */
  const seek = index => {
    move(index);
    if (video && video.readyState) video.currentTime = (current + 0.5) / data.fps;
  };
  const follow = () => move(Math.floor(video.currentTime * data.fps + 1e-3));
  const frameAt = event => {
    const time = begin + (event.clientX - box.getBoundingClientRect().left - left) / (width - left - right) * (end - begin);
    const index = ends.findIndex(stop => time < stop);
    return index < 0 ? last : index;
  };

  box.addEventListener("pointerdown", event => { box.setPointerCapture(event.pointerId); seek(frameAt(event)); });
  box.addEventListener("pointermove", event => { if (event.buttons || !video) seek(frameAt(event)); });
  box.addEventListener("keydown", event => {
    const steps = {ArrowLeft: -1, ArrowRight: 1, PageDown: -10, PageUp: 10, Home: -last, End: last};
    if (!(event.key in steps)) return;
    event.preventDefault();
    if (video) video.pause();
    seek(current + steps[event.key]);
  });
  if (video) {
    const failed = () => { document.getElementById("unplayable").hidden = false; };
    video.addEventListener("error", failed);
    if (video.error) failed();
    video.addEventListener("loadedmetadata", () => { if (current) seek(current); });
    for (const name of ["seeked", "timeupdate"]) video.addEventListener(name, follow);
    video.addEventListener("play", () => {
      const tick = () => { if (!video.paused) { follow(); requestAnimationFrame(tick); } };
      tick();
    });
  }
  new ResizeObserver(drawAll).observe(box);
  drawAll();
}

if (document.getElementById("data")) showCurves(JSON.parse(document.getElementById("data").textContent));
