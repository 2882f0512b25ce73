"use strict";

/* Page of a clip: curves under a cursor that goes with the video. */
function showCurves(data) {
  const box = document.getElementById("curves"), now = document.getElementById("now");
  const video = document.getElementById("video");
  const times = data.time_s, last = times.length - 1;
  const left = 60, right = 14;
  let current = data.open, width = 0, cursors = [];
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
  const draw = (kind, title, layers) => {
    const height = 165, top = 6, bottom = height - 8, svg = panel(height, title);
    let low = 0, high = 0;
    for (const piece of layers.flat()) {  // a hundredfold interval would flatten the rest
      low = Math.min(low, piece.value, Math.max(piece.low ?? piece.value, -5 * Math.abs(piece.value)));
      high = Math.max(high, piece.value, Math.min(piece.high ?? piece.value, 5 * Math.abs(piece.value)));
    }
    high += 0.05 * (high - low) || 1;
    const y = value => bottom - (Math.min(Math.max(value, low), high) - low) / (high - low) * (bottom - top);
    for (const tick of ticks(low, high, 4)) {
      add(svg, "line", {class: "grid", x1: left, x2: width - right, y1: y(tick), y2: y(tick)});
      add(svg, "text", {x: left - 6, y: y(tick) + 4, "text-anchor": "end"}, digits(tick));
    }
    layers.forEach((pieces, layer) => {
      const group = add(svg, "g", {class: `${kind} layer${layer}`});
      for (const {begin, end, value, low: least, high: most, sure} of pieces) {
        const place = {x: x(begin), width: x(end) - x(begin)}, unsure = sure ? "" : " unsure";
        if (least !== null && most !== null) add(group, "rect", {...place, class: "interval" + unsure, y: y(most), height: y(least) - y(most)});
        add(group, "line", {class: "value" + unsure, x1: place.x, x2: x(end), y1: y(value), y2: y(value)});
      }
    });
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

  const pieces = (begins, lasts, source, names, sure) => begins.map((begin, index) => ({
    begin, end: begin + lasts[index], sure: sure === undefined || sure[index],
    value: source[names[0]][index], low: source[names[1]][index], high: source[names[2]][index],
  })).filter(piece => piece.value !== null);
  const forces = contact => pieces(contact.time_s, contact.frame_s, contact, ["force", "force_low", "force_high"]);
  const stiffness = ["stiffness", "stiffness_low", "stiffness_high"];
  const frames = pieces(times, ends.map((end, index) => end - times[index]), data, stiffness, data.sure);
  const whole = data.contacts.filter(contact => contact.stiffness !== null && contact.time_s.length).map(contact => ({
    begin: contact.time_s[0], end: contact.time_s.at(-1) + contact.frame_s.at(-1),
    value: contact.stiffness, low: contact.stiffness_low, high: contact.stiffness_high, sure: contact.sure,
  }));

  const drawAll = () => {
    if (box.clientWidth === width) return;
    width = box.clientWidth;
    cursors = [];
    box.replaceChildren();
    if (frames.length + whole.length) draw("stiffness", "stiffness k_s [f/u]", [frames, whole]);
    const shown = data.contacts.filter(contact => !contact.flat);
    for (const unit of new Set(shown.map(contact => contact.unit).filter(unit => unit))) {
      draw("force", "force, " + unit, [[], shown.filter(contact => contact.unit === unit).flatMap(forces)]);
    }
    band("what each frame shows", data.state, "v-");
    if (data.alarm) band("alarm of the force limit", data.alarm, "a-");
    axis();
    move(current);
  };

  const ranged = (value, low, high) => digits(value) + (low === null || high === null ? "" : ` (${digits(low)} to ${digits(high)})`);
  const said = index => {
    const parts = [`frame ${data.frame[index]}, ${times[index].toFixed(2)} s: ${data.state.words[data.state.index[index]]}`];
    for (const contact of data.contacts) {
      const at = contact.time_s.findIndex(time => Math.abs(time - times[index]) < 1e-6);
      if (at < 0) continue;
      const force = contact.force[at];
      if (contact.words !== data.state.words[data.state.index[index]]) parts.push("whole contact: " + contact.words);
      if (!contact.flat) parts.push(force === null ? "force unknown" : `force ${ranged(force, contact.force_low[at], contact.force_high[at])} ${contact.unit}`);
    }
    const value = data.stiffness[index];
    if (value !== null) parts.push(`stiffness ${ranged(value, data.stiffness_low[index], data.stiffness_high[index])} f/u${data.sure[index] ? "" : " (not determined)"}`);
    if (data.alarm && data.alarm.names[data.alarm.index[index]]) parts.push("alarm: " + data.alarm.names[data.alarm.index[index]]);
    const detail = data.detail.names[data.detail.index[index]];
    return parts.join("; ") + (detail ? ". " + detail : "");
  };
  const move = index => {
    current = Math.min(Math.max(index, 0), last);
    const at = x(times[current]);
    for (const cursor of cursors) { cursor.setAttribute("x1", at); cursor.setAttribute("x2", at); }
    now.textContent = said(current);
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
    video.addEventListener("loadedmetadata", () => seek(current));
    if (video.readyState) seek(current);
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
