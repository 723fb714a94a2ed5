"use strict";
// What the page adds when scripts run: one problem and scenario at a time, a legend that hides controllers, all of it in
// the address; charts that answer pointer, fingers and keys, figures saved as files, tables that sort, a theme switch.
// Without it the page shows the same figures as drawings, and scenarios folded.
(function () {
  // Charts are made live by a library that the page holds deflated; a browser that cannot inflate keeps the drawings.
  const lively = "DecompressionStream" in window && "IntersectionObserver" in window;
  document.documentElement.classList.add("scripted", ...(lively ? ["lively"] : []));
  const narrow = window.matchMedia("screen and (max-width: 640px)"); // as in the style: charts are laid out anew, not shrunk
  const charts = new Map(); // live charts by their boxes
  const begun = new Map(); // promises of them
  const inView = new Set(); // boxes
  const hidden = new Set(); // lines of the controllers that the reader hid, on the whole page
  const spans = {}; // the time shown, by part of the page
  let against; // the controller that the others are told against; undefined: that of the study
  const columns = {}; // samples by data set, once they are drawn
  const COLOURS = Number(document.documentElement.dataset.colours);
  let page, library, working, status;

  function element(tag, className, text) {
    const made = document.createElement(tag);
    if (className) made.className = className;
    if (text !== undefined) made.textContent = text;
    return made;
  }

  // ---- data -------------------------------------------------------------------------------------------
  const inflated = (id) => inflatedText(document.getElementById(id).textContent);

  async function inflatedText(deflated) {
    const text = atob(deflated);
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).text();
  }

  async function load() {
    page = JSON.parse(await inflated("report-data"));
    const script = element("script", "", await inflated("chart-library"));
    await idle();
    document.head.append(script);
    await idle();
    return window.chartLibrary;
  }

  // A column comes as decimals, first value, and changes from value to value, all whole numbers.
  function unpacked([decimals, ...changes]) {
    let sum = 0;
    const value = decimals < 0 ? (whole) => whole * 10 ** -decimals : (whole) => whole / 10 ** decimals;
    return changes.map((change) => (change === null ? null : value((sum += change))));
  }

  function columnsOf(name) {
    return (columns[name] ||= Object.fromEntries(Object.entries(page.data[name]).map(([key, packed]) => [key, unpacked(packed)])));
  }

  function rowsOf(name) {
    const entries = Object.entries(columnsOf(name));
    return columnsOf(name).t.map((_, i) => Object.fromEntries(entries.map(([key, column]) => [key, column[i] ?? null])));
  }

  const bandOf = (name) => name + "-band"; // the data of the bands over the seeds, if there are any

  function nearest(times, time) {
    let low = 0;
    let high = times.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= time) low = middle;
      else high = middle;
    }
    return time - times[low] <= times[high] - time ? low : high;
  }

  // Times have more digits where their unit is so large that the time between samples would be lost.
  const moment = (chart, time) => written(time, chart.time, chart.time === "s" ? 4 : 6);

  function written(value, unit, digits = 4) {
    if (value === null || value === undefined) return "–";
    const size = Math.abs(value);
    const text = value !== 0 && (size < 1e-4 || size >= 1e6) ? value.toExponential(3) : Number(value.toPrecision(digits)).toString();
    return text.replace(/-/g, "−") + (unit === "°" ? "°" : unit ? "\u00a0" + unit : "");
  }

  // ---- what the charts show: of what is hidden and of the time shown the page holds one state -----------
  const visible = (names) => names.filter((name) => !hidden.has(name));
  const inFigure = (chart) => [...charts.values()].filter((other) => other.figure === chart.figure);
  const announce = (text) => { status.textContent = text; };
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];

  function tell(some, values) {
    for (const { view, signals } of some) {
      for (const [name, value] of Object.entries(values)) if (signals.has(name)) view.signal(name, value);
      view.runAsync();
    }
  }

  // The charts in view follow at once, the others when they come into view.
  function update() {
    for (const chart of charts.values()) chart.stale = true;
    for (const box of inView) if (charts.get(box)) follow(charts.get(box));
  }

  function follow(chart) {
    chart.stale = false;
    const units = narrow.matches ? chart.box.clientWidth : chart.width;
    if (units !== chart.units) chart.view.width((chart.units = units));
    const state = { hidden: [...hidden] };
    if (chart.times) Object.assign(state, { span: spanOf(chart), extent: extent(chart) });
    if (!state.extent) delete state.extent;
    if (chart.reset) chart.reset.hidden = !state.span;
    tell([chart], state);
  }

  function zoom(chart, span) {
    const ends = [chart.times[0], chart.times[chart.times.length - 1]];
    const least = 2 * (chart.times[1] - chart.times[0]);
    let asked = span && [Math.max(span[0], ends[0]), Math.min(span[1], ends[1])];
    if (asked && asked[0] === ends[0] && asked[1] === ends[1]) asked = null;
    if (asked && !(asked[1] - asked[0] >= least)) return;
    spans[chart.group] = asked;
    update();
    writeAddress("zoom");
    announce(asked ? `${moment(chart, asked[0])} to ${moment(chart, asked[1])}` : "the whole time");
  }

  // The time shown; one that an address names may lie outside of what there is.
  function spanOf(chart) {
    const span = spans[chart.group];
    return span && span[0] < chart.times[chart.times.length - 1] && span[1] > chart.times[0] ? span : null;
  }

  // The range of the values: of the controllers that set it, if any of them is shown, in the time shown.
  function extent(chart) {
    const span = spanOf(chart);
    const whole = chart.spec.signals.find((one) => one.name === "extent").value;
    if (chart.fixed && !span) return whole;
    const trusted = visible(chart.scaled);
    const names = trusted.length ? trusted : visible(Object.keys(chart.lines));
    const [first, last] = span || [-Infinity, Infinity];
    const values = span ? [] : [...chart.limits];
    function collect(data, wanted) {
      const drawn = wanted.map((name) => data[name]).filter(Boolean);
      data.t.forEach((time, i) => {
        if (time < first || time > last) return;
        for (const column of drawn) if (column[i] !== null && column[i] !== undefined) values.push(column[i]);
      });
    }
    collect(columnsOf(chart.data), [...names, "r", ...chart.also]);
    if (page.data[bandOf(chart.data)]) collect(columnsOf(bandOf(chart.data)), names.flatMap((name) => [name + "l", name + "h"]));
    const low = values.reduce((a, b) => Math.min(a, b), Infinity);
    const high = values.reduce((a, b) => Math.max(a, b), -Infinity);
    const room = chart.limits.length && !span ? 0.1 : 0.05;
    const margin = room * (high - low) || 0.1 * Math.abs(high) || 1;
    if (low > high) return null;
    // Zoomed charts of errors must not be flattened by the transients that they leave out.
    const inside = chart.fixed && low < whole[1] && high > whole[0];
    return inside ? [Math.max(low - margin, whole[0]), Math.min(high + margin, whole[1])] : [low - margin, high + margin];
  }

  function zoomAbout(chart, time, factor) {
    const [first, last] = spanOf(chart) || [chart.times[0], chart.times[chart.times.length - 1]];
    zoom(chart, [time - (time - first) * factor, time + (last - time) * factor]);
  }

  // ---- reading values ---------------------------------------------------------------------------------
  const scaleOf = (chart) => chart.live.clientWidth / chart.units; // pixels a unit of the drawing

  function place(chart, x, y) {
    const note = chart.reading;
    const left = x + 16 + note.offsetWidth > chart.box.clientWidth ? x - 16 - note.offsetWidth : x + 16;
    note.style.left = Math.max(0, left) + "px";
    note.style.top = Math.max(0, y) + "px";
  }

  function read(chart, index) {
    const data = columnsOf(chart.data);
    const note = chart.reading;
    chart.index = index;
    note.replaceChildren(element("b", "", "t = " + moment(chart, data.t[index])));
    if (data.r) line(note, "var(--ink)", "reference", written(data.r[index], chart.unit));
    for (const [name, [label, paint]] of Object.entries(chart.given)) line(note, paint, label, written(data[name][index], chart.unit));
    for (const name of visible(Object.keys(chart.lines))) line(note, colour(name), chart.lines[name], written(data[name][index], chart.unit));
    note.hidden = false;
    place(chart, scaleOf(chart) * (chart.view.origin()[0] + chart.view.scale("x")(data.t[index])), 8);
    tell(inFigure(chart), { at: data.t[index] });
  }

  function colour(name) {
    return "var(--c" + (Number(name.slice(1)) % COLOURS) + ")";
  }

  function line(note, paint, label, value) {
    const row = element("div");
    const dot = element("i");
    dot.style.background = paint;
    row.append(dot, element("span", "", label), " ", element("span", "", value), " ");
    note.append(" ", row);
  }

  function forget(chart) {
    chart.reading.hidden = true;
    if (chart.times) tell(inFigure(chart), { at: null, band: null });
  }

  // ---- pointer, fingers and keys on a chart over time ---------------------------------------------------
  function timeAt(chart, event) {
    const x = (event.clientX - chart.live.getBoundingClientRect().left) / scaleOf(chart);
    return chart.view.scale("x").invert(x - chart.view.origin()[0]);
  }

  function listenOverTime(chart) {
    const live = chart.live;
    const fingers = new Map(); // the time that each one holds, and where it is
    let from = null;
    live.addEventListener("pointerdown", (event) => {
      const time = timeAt(chart, event);
      if (event.pointerType === "touch") {
        fingers.set(event.pointerId, { time, event });
        read(chart, nearest(chart.times, time));
      } else if (event.button === 0) {
        live.setPointerCapture(event.pointerId);
        from = time;
      }
    });
    live.addEventListener("pointermove", (event) => {
      if (fingers.has(event.pointerId)) fingers.get(event.pointerId).event = event;
      if (fingers.size === 2) return pinch(chart, [...fingers.values()]);
      const time = timeAt(chart, event);
      read(chart, nearest(chart.times, time));
      if (from !== null) tell(inFigure(chart), { band: [Math.min(from, time), Math.max(from, time)] });
    });
    live.addEventListener("pointerup", (event) => {
      fingers.delete(event.pointerId);
      if (from === null) return;
      const span = [from, timeAt(chart, event)].sort((a, b) => a - b);
      from = null;
      forget(chart);
      zoom(chart, span);
    });
    live.addEventListener("pointercancel", (event) => {
      fingers.delete(event.pointerId);
      from = null;
      forget(chart);
    });
    // What a finger read stays until another place is touched.
    live.addEventListener("pointerleave", (event) => { if (event.pointerType !== "touch") forget(chart); });
    live.addEventListener("dblclick", () => zoom(chart, null));
    live.addEventListener("wheel", (event) => {
      // The wheel alone belongs to the page: a report is scrolled far more often than a chart is zoomed.
      if (!event.ctrlKey && !event.shiftKey && !event.metaKey) return;
      event.preventDefault();
      zoomAbout(chart, timeAt(chart, event), event.deltaY + event.deltaX > 0 ? 1.25 : 0.8);
    }, { passive: false });
    live.addEventListener("keydown", (event) => onKey(chart, event));
  }

  // Two fingers keep the times that they hold.
  function pinch(chart, fingers) {
    const [left, right] = fingers.sort((a, b) => a.time - b.time);
    const box = chart.live.getBoundingClientRect();
    const scale = chart.view.scale("x");
    const [start, end] = scale.range().map((x) => box.left + scaleOf(chart) * (chart.view.origin()[0] + x));
    const perPixel = (right.time - left.time) / (right.event.clientX - left.event.clientX);
    const at = (x) => left.time + (x - left.event.clientX) * perPixel;
    chart.reading.hidden = true;
    if (perPixel > 0 && Number.isFinite(perPixel)) zoom(chart, [at(start), at(end)]);
  }

  function onKey(chart, event) {
    const last = chart.times.length - 1;
    const step = event.shiftKey ? 10 : 1;
    const index = chart.index ?? 0;
    const places = { ArrowLeft: index - step, ArrowRight: index + step, Home: 0, End: last };
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.key in places) {
      read(chart, Math.min(last, Math.max(0, places[event.key])));
      announce(chart.reading.textContent);
    } else if (event.key === "+" || event.key === "=") zoomAbout(chart, chart.times[index], 0.8);
    else if (event.key === "-") zoomAbout(chart, chart.times[index], 1.25);
    else if (event.key === "Escape") { zoom(chart, null); forget(chart); }
    else return;
    event.preventDefault();
  }

  // ---- pointer and keys on a chart of marks that have words ---------------------------------------------
  function say(chart, text, x, y) {
    chart.reading.hidden = !text;
    if (!text) return;
    chart.reading.textContent = text;
    place(chart, x, y + 12);
  }

  // The marks with words and where they are, from above to below and from left to right.
  function marksOf(chart) {
    const found = [];
    const walk = (item, x, y) => {
      if (item.marktype) return item.items.forEach((one) => walk(one, x, y));
      if (item.datum && item.datum.text && item.mark.marktype !== "group") found.push([item.datum.text, x + (item.x || 0), y + (item.y || 0)]);
      (item.items || []).forEach((one) => walk(one, x + (item.x || 0), y + (item.y || 0)));
    };
    walk(chart.view.scenegraph().root, ...chart.view.origin());
    return found.sort((a, b) => a[2] - b[2] || a[1] - b[1]).filter(([text], i, all) => all.findIndex((one) => one[0] === text) === i);
  }

  function listenToMarks(chart) {
    const { live, box } = chart;
    for (const kind of ["pointermove", "pointerdown"]) {
      chart.view.addEventListener(kind, (event, item) => {
        const { left, top } = box.getBoundingClientRect();
        say(chart, item && item.datum && item.datum.text, event.clientX - left, event.clientY - top);
      });
    }
    live.addEventListener("pointerleave", (event) => { if (event.pointerType !== "touch") forget(chart); });
    live.addEventListener("keydown", (event) => {
      const marks = marksOf(chart);
      const last = marks.length - 1;
      const index = Math.min(chart.index ?? -1, last);
      const places = { ArrowLeft: index - 1, ArrowUp: index - 1, ArrowRight: index + 1, ArrowDown: index + 1, Home: 0, End: last };
      if (last < 0 || event.ctrlKey || event.altKey || event.metaKey) return;
      if (event.key === "Escape") forget(chart);
      if (!(event.key in places)) return;
      event.preventDefault();
      chart.index = Math.min(last, Math.max(0, places[event.key]));
      const [text, x, y] = marks[chart.index];
      say(chart, text, scaleOf(chart) * x, scaleOf(chart) * y);
      announce(text);
    });
  }

  // ---- making the charts: those in view, one after the other, while the browser has nothing else to do ----
  const idle = () => new Promise((go) => (window.requestIdleCallback ? requestIdleCallback(go, { timeout: 500 }) : setTimeout(go, 20)));

  async function work() {
    if (working) return;
    working = true;
    const next = () => [...inView].find((box) => !begun.has(box) || (charts.has(box) && charts.get(box).stale));
    for (let box = next(); box; box = next()) {
      await idle();
      await current(box);
    }
    working = false;
    document.documentElement.dataset.ready = "yes";
  }

  // Make a chart live, or have a live one show what the others show; a drawing that cannot be made live stays.
  function current(box) {
    if (charts.has(box)) follow(charts.get(box));
    else if (!begun.has(box)) begun.set(box, draw(box).catch(reportError));
    return begun.get(box);
  }

  async function draw(box) {
    const { View, parse, expressionInterpreter } = await (library ||= load());
    const told = page.views[box.dataset.view];
    if (!told) return;
    const live = element("div", "live");
    const inner = element("div"); // Vega writes a role of its own onto what it draws into
    const reading = element("div", "reading");
    const width = told.spec.width;
    const units = narrow.matches ? box.clientWidth : width;
    reading.hidden = true;
    reading.setAttribute("aria-hidden", "true"); // what keys read is announced
    // The label of the box says what the drawing shows; its parts say nothing more.
    inner.setAttribute("aria-hidden", "true");
    live.setAttribute("role", "img");
    live.setAttribute("aria-label", box.querySelector(".static").getAttribute("aria-label"));
    live.tabIndex = 0;
    live.append(inner);
    box.append(live, reading);
    const own = [told.data, bandOf(told.data)];
    const data = told.spec.data.map((one) => (own.includes(one.name) ? { ...one, values: rowsOf(one.name) } : one));
    const view = new View(parse({ ...told.spec, width: units, data }, null, { ast: true }), {
      renderer: "svg", container: inner, hover: false, expr: expressionInterpreter, logLevel: 1,
    });
    const signals = new Set((told.spec.signals || []).map((signal) => signal.name));
    const chart = { ...told, box, live, reading, view, signals, width, units, times: told.data ? columnsOf(told.data).t : null };
    if (chart.times) addReset(chart);
    await idle();
    charts.set(box, chart);
    follow(chart);
    await view.runAsync();
    inner.querySelector("svg > g").setAttribute("inert", ""); // as the static drawing
    box.classList.add("is-live");
    live.addEventListener("blur", () => forget(chart));
    if (chart.times) listenOverTime(chart);
    else listenToMarks(chart);
  }

  function addReset(chart) {
    chart.reset = element("button", "reset", "Reset zoom");
    chart.reset.type = "button";
    chart.reset.hidden = true;
    chart.reset.addEventListener("click", () => {
      zoom(chart, null);
      chart.live.focus({ preventScroll: true });
    });
    chart.box.append(chart.reset);
  }

  // What is folded is not in view before it is opened; then it shows what its neighbours show.
  function watchCharts() {
    const seen = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) {
        if (isIntersecting) inView.add(target);
        else inView.delete(target);
      }
      work();
    }, { rootMargin: "150px 0px" });
    const boxes = document.querySelectorAll(".chart");
    boxes.forEach((box) => seen.observe(box));
    if (!boxes.length) work();
    narrow.addEventListener("change", update);
    window.addEventListener("resize", () => { if (narrow.matches) update(); });
  }

  // ---- figures as files: what is shown, in the colours of the light page, on white -----------------------
  const MARGIN = 16;

  function drawn(tag, attributes, text) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (text !== undefined) made.textContent = text;
    return made;
  }

  function picture(figure) {
    const caption = figure.querySelector("figcaption").textContent;
    const style = { "font-family": "system-ui, Arial, sans-serif", "font-size": 13, fill: "var(--ink)" };
    const pen = document.createElement("canvas").getContext("2d");
    pen.font = "13px system-ui, Arial, sans-serif";
    const boxes = [...figure.querySelectorAll(".chart")].map((box) => box.querySelector(".is-live > .live svg") || box.querySelector("svg")).filter(Boolean);
    const width = 2 * MARGIN + Math.max(...boxes.map((svg) => svg.viewBox.baseVal.width));
    const all = drawn("svg", { xmlns: "http://www.w3.org/2000/svg", role: "img", "aria-label": caption });
    const ground = drawn("rect", { width: "100%", height: "100%", fill: "#fff" });
    all.append(drawn("title", {}, caption), ground);
    let [x, y] = [MARGIN, MARGIN];
    for (const entry of figure.querySelectorAll(".legend li:not([hidden]) .entry")) {
      const text = entry.textContent.trim();
      const room = 34 + pen.measureText(text).width + 22;
      if (x > MARGIN && x + room > width) [x, y] = [MARGIN, y + 20];
      const swatch = entry.querySelector("line, path").cloneNode();
      swatch.setAttribute("stroke-width", 2);
      const group = drawn("g", { transform: `translate(${x},${y})` });
      group.append(swatch, drawn("text", { x: 34, y: 8, ...style }, text));
      all.append(group);
      x += room;
    }
    if (x > MARGIN) y += 28;
    for (const part of figure.querySelectorAll(".panel, .chart")) {
      const svg = part.querySelector(":scope.is-live > .live svg") || part.querySelector("svg");
      if (svg) {
        const copy = svg.cloneNode(true);
        const { width: wide, height: high } = svg.viewBox.baseVal;
        ["class", "style", "aria-label", "role"].forEach((name) => copy.removeAttribute(name));
        for (const [name, value] of Object.entries({ x: MARGIN, y, width: wide, height: high, overflow: "visible" })) copy.setAttribute(name, value);
        all.append(copy);
        y += high + 8;
      } else if (part.matches(".panel")) {
        all.append(drawn("text", { x: MARGIN, y: y + 14, "font-weight": 600, ...style }, part.textContent));
        y += 24;
      }
    }
    const height = Math.ceil(y + MARGIN);
    for (const [name, value] of Object.entries({ width, height, viewBox: `0 0 ${width} ${height}` })) all.setAttribute(name, value);
    return { text: inLight(new XMLSerializer().serializeToString(all)), width, height };
  }

  function inLight(text) {
    const probe = element("span");
    probe.style.colorScheme = "light";
    document.body.append(probe);
    const found = text.replace(/var\((--[\w-]+)\)/g, (variable) => {
      probe.style.color = variable;
      return getComputedStyle(probe).color;
    });
    probe.remove();
    return found;
  }

  async function painted({ text, width, height }) {
    const image = new Image();
    image.src = "data:image/svg+xml;charset=utf-8," + encodeURIComponent(text);
    await image.decode();
    const canvas = element("canvas");
    [canvas.width, canvas.height] = [2 * width, 2 * height];
    const pen = canvas.getContext("2d");
    pen.drawImage(image, 0, 0, canvas.width, canvas.height);
    return new Promise((done) => canvas.toBlob(done, "image/png"));
  }

  async function save(figure, kind) {
    for (const box of figure.querySelectorAll(".chart")) {
      await current(box);
      if (charts.has(box)) await charts.get(box).view.runAsync();
    }
    const made = picture(figure);
    const link = element("a");
    link.download = `${document.title.replace(/[^\p{L}\p{N}]+/gu, "-").slice(0, 60)}-${figure.id}.${kind}`;
    link.href = URL.createObjectURL(kind === "svg" ? new Blob([made.text], { type: "image/svg+xml" }) : await painted(made));
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    announce(`Saved as ${link.download}`);
  }

  // ---- one problem and scenario at a time, and whose lines and rows are shown ------------------------------
  const FIRST = "initial"; // what is shown unless the address says otherwise
  const chosen = {}; // problem and scenario, by name
  const tabsOf = (list) => all("[role=tab]", list);
  const lists = () => all("[role=tablist]");
  const buttons = () => all("button.entry");
  let lines; // of all controllers by their keys

  // The tab of a list that is chosen, or the first choice where the list does not have what is chosen.
  function tabOf(list) {
    const tabs = tabsOf(list);
    return tabs.find((tab) => tab.dataset.name === chosen[list.dataset.switch]) || tabs.find((tab) => FIRST in tab.dataset);
  }

  const problems = () => document.querySelector("[data-switch=problem]");
  // What a part of the page is called within it, in order: the parts of problems, or the only one.
  function partShown() {
    const tab = problems() && tabOf(problems());
    return tab ? tab.dataset.panel : (all("article.study.has-legend").map((article) => article.id)[0] || "").replace(/part$/, "");
  }

  const legendOf = (part) => document.querySelector(`.shown [data-part="${part}"]`);

  function show() {
    const part = partShown();
    for (const list of lists()) {
      const current = tabOf(list);
      for (const tab of tabsOf(list)) {
        tab.setAttribute("aria-selected", String(tab === current));
        tab.tabIndex = tab === current ? 0 : -1;
      }
      const { name } = current.dataset;
      const within = list.closest("[data-part]");
      const panels = within ? all(`#${within.dataset.part}part .scenario`) : all(".problem");
      for (const panel of panels) {
        const isShown = within ? panel.dataset.scenario === name : panel.dataset.part === current.dataset.panel;
        panel.hidden = !isShown;
        panel.firstElementChild.open = isShown;
      }
      if (!within) all("[data-part]:not(.problem)").forEach((group) => { group.hidden = group.dataset.part !== part; });
      else all("[data-scenario]", within).forEach((note) => { note.hidden = note.dataset.scenario !== name; });
    }
    for (const section of new Set(all("section > .scenario").map((panel) => panel.parentElement))) {
      const isEmpty = all(":scope > .scenario", section).every((panel) => panel.hidden);
      section.classList.toggle("has-nothing", isEmpty);
    }
    filter();
    sayShown(part);
    update();
  }

  // Rows, entries of legends and lines of drawings go with what is hidden; live charts follow by themselves.
  function filter() {
    const keys = new Set(Object.keys(lines).filter((key) => hidden.has(lines[key])));
    for (const button of buttons()) button.setAttribute("aria-pressed", String(!keys.has(button.dataset.controller)));
    for (const entry of all("tr[data-controller], .legend li[data-controller], .smalls > li[data-controller]")) entry.hidden = keys.has(entry.dataset.controller);
    for (const head of all("thead th[data-controller]")) {
      for (const row of head.closest("table").rows) {
        if (row.cells[head.cellIndex]) row.cells[head.cellIndex].hidden = keys.has(head.dataset.controller);
      }
    }
    for (const body of all("tbody > .group").map((row) => row.parentElement)) {
      body.hidden = all("tr:not(.group)", body).every((row) => row.hidden);
    }
    paint("shown-lines", [...hidden].map((line) => `.chart[data-lines~="${line}"] .static ${inColour(line)} { display: none; }`));
  }

  const inColour = (line) => `:is([stroke="${colour(line)}"], [fill="${colour(line)}"])`;

  // Whatever is not of this controller is faint, in figures and tables, while its entry is pointed at or has the focus.
  function light(button) {
    const line = button && button.dataset.name;
    const drawn = ':is([stroke^="var(--c"], [fill^="var(--c"])';
    paint("lit-lines", line ? [
      `.chart:is(:not([data-lines]), [data-lines~="${line}"]) svg ${drawn}:not(${inColour(line)}), ` +
      `.chart[data-lines]:not([data-lines~="${line}"]) svg ${drawn} { opacity: 0.15; }`,
    ] : []);
    for (const row of all("tr[data-controller]")) row.classList.toggle("lit", Boolean(button) && row.dataset.controller === button.dataset.controller);
  }

  function paint(id, rules) {
    const style = document.getElementById(id) || document.head.appendChild(Object.assign(element("style"), { id }));
    style.textContent = rules.join("\n");
  }

  function sayShown(part) {
    const group = legendOf(part);
    if (!group) return;
    const entries = all("button.entry", group);
    const count = entries.filter((entry) => !hidden.has(entry.dataset.name)).length;
    const named = [...(problems() ? [problems()] : []), ...all("[role=tablist]", group)].map((list) => tabOf(list).textContent.trim());
    const words = [...named, `${count} of ${entries.length} controllers`].join(" \u00b7 ");
    document.querySelector(".shown-words").textContent = words;
    for (const button of all("[data-first]", group)) {
      const shown = first(group, button.dataset.first);
      button.setAttribute("aria-pressed", String(entries.every((entry) => shown.includes(entry) !== hidden.has(entry.dataset.name))));
    }
  }

  // The first controllers of a legend, which has them in the order of their ranks.
  const first = (group, count) => all("button.entry", group).slice(0, count === "all" ? Infinity : Number(count));

  function choose(tab) {
    chosen[tab.parentElement.dataset.switch] = tab.dataset.name;
    show();
    writeAddress();
    announce(tab.textContent.trim());
  }

  function onTabKey(list, event) {
    const tabs = tabsOf(list);
    const at = tabs.indexOf(document.activeElement);
    const last = tabs.length - 1;
    const before = at ? at - 1 : last;
    const after = at < last ? at + 1 : 0;
    const places = { ArrowLeft: before, ArrowUp: before, ArrowRight: after, ArrowDown: after, Home: 0, End: last };
    if (at < 0 || !(event.key in places) || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    tabs[places[event.key]].focus();
    choose(tabs[places[event.key]]);
  }

  function choosing(hide) {
    hide();
    show();
    writeAddress();
    announce(document.querySelector(".shown-words").textContent);
  }

  const choices = () => all(".against select");
  const initial = (select) => select.closest(".against").dataset.chosen;

  // One baseline for the whole page; a part that does not have it keeps that of the study.
  function chooseAgainst() {
    for (const select of choices()) {
      const known = [...select.options].some((option) => option.value === against);
      select.value = known ? against : initial(select);
      select.dispatchEvent(new Event("chosen"));
    }
  }

  // Panels get their roles here: without scripts they are folded sections.
  function enablePanels(list) {
    const within = list.closest("[data-part]");
    const part = within ? within.dataset.part : "";
    tabsOf(list).forEach((tab, number) => {
      tab.id = `${part}${list.dataset.switch}-tab-${number}`;
      if (tab.getAttribute("aria-selected") === "true") tab.dataset[FIRST] = "";
      const { name } = tab.dataset;
      const panels = within ? all(`#${part}part .scenario`).filter((panel) => panel.dataset.scenario === name) : [document.querySelector(`.problem[data-part="${tab.dataset.panel}"]`)];
      panels.forEach((panel, place) => {
        panel.id = `${tab.id}-panel-${place}`;
        panel.setAttribute("role", "tabpanel");
        panel.setAttribute("aria-labelledby", tab.id);
      });
      if (panels.length) tab.setAttribute("aria-controls", panels.map((panel) => panel.id).join(" "));
      tab.addEventListener("click", () => choose(tab));
    });
    list.addEventListener("keydown", (event) => onTabKey(list, event));
  }

  function enableShown() {
    const box = document.querySelector(".shown > details");
    lines = Object.fromEntries(buttons().map((button) => [button.dataset.controller, button.dataset.name]));
    if (!box) return;
    const wide = window.matchMedia("(min-width: 1001px)"); // as in the style: beside the page there is room for it
    const unfold = () => { box.open = wide.matches; };
    wide.addEventListener("change", unfold);
    unfold();
    document.documentElement.classList.add("switched");
    lists().forEach(enablePanels);
    all(".scenario > details > summary, .problem > details > summary").forEach((summary) => { summary.tabIndex = -1; });
    for (const button of buttons()) {
      const line = button.dataset.name;
      button.addEventListener("click", () => choosing(() => { if (!hidden.delete(line)) hidden.add(line); }));
      button.addEventListener("pointerenter", (event) => { if (event.pointerType === "mouse") light(button); });
      button.addEventListener("focus", () => { if (button.matches(":focus-visible")) light(button); });
      for (const kind of ["pointerleave", "blur"]) button.addEventListener(kind, () => light(null));
    }
    for (const button of all("[data-first]")) {
      button.addEventListener("click", () => choosing(() => {
        const shown = first(button.closest("[data-part]"), button.dataset.first).map((entry) => entry.dataset.name);
        hidden.clear();
        if (button.dataset.first !== "all") Object.values(lines).filter((line) => !shown.includes(line)).forEach((line) => hidden.add(line));
      }));
    }
    for (const select of choices()) {
      select.addEventListener("change", () => {
        against = select.value;
        chooseAgainst();
        writeAddress();
      });
    }
    readAddress();
    window.addEventListener("popstate", onAddress);
    if (anchorOf(location.hash)) reveal(anchorOf(location.hash));
    remember("replaceState", location.hash || "#");
  }

  // ---- the address: where in the page, and what of it is shown ---------------------------------------------
  const OURS = { ours: true }; // of entries of the history that say all of it
  const NUMBER = "(-?\\d+(?:\\.\\d+)?(?:e[-+]?\\d+)?)";
  const SPAN = new RegExp(`^${NUMBER}\\.\\.${NUMBER}$`);
  let lastWritten = { kind: "", time: 0 };

  const termsOf = (hash) => hash.replace(/^#/, "").split("&").filter(Boolean);
  const anchorOf = (hash) => termsOf(hash).find((term) => !term.includes("="));

  function decoded(text) {
    try {
      return decodeURIComponent(text);
    } catch {
      return ""; // half of an escape, where a mail broke the line
    }
  }

  // Show what the address says; what it says of things that this page does not have counts for nothing.
  function readAddress() {
    const said = Object.fromEntries(termsOf(location.hash).filter((term) => term.includes("=")).map((term) => [term.slice(0, term.indexOf("=")), term.slice(term.indexOf("=") + 1)]));
    for (const kind of ["problem", "scenario"]) chosen[kind] = kind in said ? decoded(said[kind]) : undefined;
    const keys = "show" in said ? said.show.split(",").map(decoded).filter((key) => key in lines) : [];
    hidden.clear();
    if (keys.length || said.show === "") Object.keys(lines).filter((key) => !keys.includes(key)).forEach((key) => hidden.add(lines[key]));
    const ends = SPAN.exec(said.zoom || "");
    const span = ends && [Number(ends[1]), Number(ends[2])];
    against = "against" in said ? decoded(said.against) : undefined;
    chooseAgainst();
    for (const part of Object.keys(spans)) delete spans[part];
    if (span && span[0] < span[1]) spans[partShown()] = span;
    show();
  }

  function address(anchor) {
    const terms = anchor ? [anchor] : [];
    const add = (name, text) => terms.push(`${name}=${text}`);
    const part = partShown();
    const group = legendOf(part);
    for (const list of [problems(), group && group.querySelector("[data-switch=scenario]")].filter(Boolean)) {
      if (!(FIRST in tabOf(list).dataset)) add(list.dataset.switch, encodeURIComponent(tabOf(list).dataset.name));
    }
    const keys = Object.keys(lines);
    if (hidden.size) add("show", keys.filter((key) => !hidden.has(lines[key])).map(encodeURIComponent).join(","));
    if (against !== undefined && choices().some((select) => select.value !== initial(select))) add("against", encodeURIComponent(against));
    if (spans[part]) add("zoom", spans[part].map((end) => Number(end.toPrecision(6))).join(".."));
    return `#${terms.join("&")}`;
  }

  // Where a page lies in a frame that may not have a history, it does without.
  function remember(method, hash) {
    try {
      history[method](OURS, "", hash === "#" ? location.href.split("#")[0] : hash);
    } catch {
      // The page shows it all the same.
    }
  }

  // A zoom by wheel or fingers comes in many steps, which are one to go back by.
  function writeAddress(kind = "") {
    if (!lines) return;
    const goesOn = kind && kind === lastWritten.kind && performance.now() - lastWritten.time < 1000;
    lastWritten = { kind, time: performance.now() };
    const hash = address();
    if (hash !== (location.hash || "#")) remember(goesOn ? "replaceState" : "pushState", hash);
  }

  // By a link within the page only the place changes; an address that was gone back to, or typed, says all of it.
  function onAddress(event) {
    const anchor = anchorOf(location.hash);
    if (event.state || termsOf(location.hash).length > Boolean(anchor)) readAddress();
    if (anchor && !event.state) {
      reveal(anchor);
      remember("replaceState", address(anchor));
    }
  }

  // Show the problem and the scenario that a place belongs to, and go there.
  function reveal(anchor) {
    const target = document.getElementById(decoded(anchor));
    if (!target) return;
    const [scenario, problem] = [target.closest(".scenario"), target.closest(".problem")];
    if (problem) chosen.problem = all("[data-switch=problem] [role=tab]").find((tab) => tab.dataset.panel === problem.dataset.part).dataset.name;
    if (scenario) chosen.scenario = scenario.dataset.scenario;
    if (scenario || problem) show();
    target.scrollIntoView();
  }

  // ---- tables, contents, theme ------------------------------------------------------------------------
  function valueOf(row, column) {
    const cell = row.cells[column];
    const text = cell.textContent.trim();
    // Of long tables numbers are read as they are shown.
    const number = cell.dataset.value ?? (cell.matches(".n") ? text.replace("−", "-") : undefined);
    return number === undefined ? text : Number.isNaN(Number(number)) ? Infinity : Number(number);
  }

  // Below the titles of groups, if there are any, the last row of the head has a cell for each column.
  const headOf = (table) => [...table.tHead.rows].at(-1).cells;

  function sortBy(table, column) {
    const head = headOf(table)[column];
    const order = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    for (const cell of headOf(table)) cell.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", order > 0 ? "ascending" : "descending");
    const body = table.tBodies[0];
    const rows = [...body.rows].map((row) => [valueOf(row, column), row]);
    rows.sort(([a], [b]) => order * (typeof a === "number" ? (a === b ? 0 : a - b) : a.localeCompare(b)));
    body.append(...rows.map(([, row]) => row));
  }

  function enableSorting(table) {
    [...headOf(table)].forEach((cell, column) => {
      const button = element("button", "sort");
      button.type = "button";
      // A link leads where it leads: the button stands beside it.
      if (cell.querySelector("a")) button.setAttribute("aria-label", "Sort by " + cell.textContent);
      else button.append(...cell.childNodes);
      button.addEventListener("click", () => sortBy(table, column));
      cell.append(button);
    });
  }

  // Long tables come deflated, and are set when they come into view.
  async function setTable(box) {
    const made = new DOMParser().parseFromString(await inflatedText(box.dataset.content), "text/html");
    box.replaceChildren(...made.body.children);
    enableTables(box);
    filter();
  }

  function watchTables() {
    const seen = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) {
        if (!isIntersecting) continue;
        seen.unobserve(target);
        setTable(target).catch(reportError);
      }
    }, { rootMargin: "300px 0px" });
    all(".deferred").forEach((box) => seen.observe(box));
  }

  function enableTables(within) {
    all(".help", within).forEach((help) => { help.hidden = false; });
    all("table.sortable", within).forEach(enableSorting);
  }

  function followContents() {
    const links = new Map([...document.querySelectorAll(".contents a")].map((link) => [link.hash.slice(1), link]));
    const seen = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        if (!entry.isIntersecting) continue;
        for (const link of links.values()) link.classList.remove("here");
        links.get(entry.target.id).classList.add("here");
      }
    }, { rootMargin: "0px 0px -75% 0px" });
    for (const id of links.keys()) seen.observe(document.getElementById(id));
  }

  function enableTheme(button) {
    const themes = ["system", "light", "dark"];
    let chosen = 0;
    button.addEventListener("click", () => {
      chosen = (chosen + 1) % themes.length;
      if (chosen) document.documentElement.dataset.theme = themes[chosen];
      else delete document.documentElement.dataset.theme;
      button.querySelector("span").textContent = themes[chosen];
    });
  }

  document.addEventListener("DOMContentLoaded", () => {
    enableTables(document);
    document.querySelectorAll("button.theme").forEach(enableTheme);
    followContents();
    status = element("p", "unseen");
    status.setAttribute("role", "status");
    document.body.append(status);
    enableShown();
    if (!lively) return;
    document.querySelectorAll("[data-save]").forEach((button) => button.addEventListener("click", () => save(button.closest("figure"), button.dataset.save)));
  });
  window.addEventListener("load", () => {
    if (lively) [watchCharts, watchTables].forEach((watch) => watch());
    else document.documentElement.dataset.ready = "yes";
  });
})();
