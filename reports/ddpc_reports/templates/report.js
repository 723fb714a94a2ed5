"use strict";
// What the page adds when scripts run: charts that answer the pointer and the keyboard, legends that hide
// controllers, tables that sort, a theme switch. Without it the page shows the same figures as drawings.
(function () {
  const page = JSON.parse(document.getElementById("report-data").textContent);
  const charts = [];
  const hidden = {};

  function element(tag, className, text) {
    const made = document.createElement(tag);
    if (className) made.className = className;
    if (text !== undefined) made.textContent = text;
    return made;
  }

  // ---- data -------------------------------------------------------------------------------------------
  function rowsOf(columns) {
    const names = Object.keys(columns);
    return columns.t.map((_, i) => {
      const row = {};
      for (const name of names) row[name] = columns[name][i] === undefined ? null : columns[name][i];
      return row;
    });
  }

  // A column comes as decimals, first value, and changes from value to value, all whole numbers.
  function unpacked([decimals, ...changes]) {
    let sum = 0;
    const value = decimals < 0 ? (whole) => whole * 10 ** -decimals : (whole) => whole / 10 ** decimals;
    return changes.map((change) => (change === null ? null : value((sum += change))));
  }

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

  function written(value, unit) {
    if (value === null || value === undefined) return "–";
    const size = Math.abs(value);
    const text = value !== 0 && (size < 1e-4 || size >= 1e6) ? value.toExponential(3) : Number(value.toPrecision(4)).toString();
    return text.replace(/-/g, "−") + (unit === "°" ? "°" : unit ? "\u00a0" + unit : "");
  }

  // ---- signals of the charts --------------------------------------------------------------------------
  function tell(some, name, value) {
    for (const chart of some) chart.view.signal(name, value).runAsync();
  }
  const together = (chart) => charts.filter((other) => other.group === chart.group && other.times);
  const sameFigure = (chart) => charts.filter((other) => other.figure === chart.figure);

  function zoom(chart, span) {
    const ends = [chart.times[0], chart.times[chart.times.length - 1]];
    const least = 2 * (chart.times[1] - chart.times[0]);
    let asked = span && [Math.max(span[0], ends[0]), Math.min(span[1], ends[1])];
    if (asked && asked[0] === ends[0] && asked[1] === ends[1]) asked = null;
    if (asked && asked[1] - asked[0] < least) return;
    for (const other of together(chart)) other.span = asked;
    tell(together(chart), "span", asked);
    together(chart).forEach(fit);
  }

  // The range of the values: of the controllers that set it, if any of them is shown, in the time shown.
  function fit(chart) {
    const data = page.data[chart.data];
    const shown = (names) => names.filter((name) => !hidden[chart.group].has(name));
    const trusted = shown(chart.scaled);
    const columns = (trusted.length ? trusted : shown(Object.keys(chart.lines))).map((name) => data[name]);
    if (data.r) columns.push(data.r);
    const [first, last] = chart.span || [-Infinity, Infinity];
    const values = chart.span ? [] : [...chart.limits];
    data.t.forEach((time, i) => {
      if (time < first || time > last) return;
      for (const column of columns) if (column[i] !== null && column[i] !== undefined) values.push(column[i]);
    });
    const low = values.reduce((a, b) => Math.min(a, b), Infinity);
    const high = values.reduce((a, b) => Math.max(a, b), -Infinity);
    if (low > high) return;
    const margin = 0.05 * (high - low) || 0.1 * Math.abs(high) || 1;
    tell([chart], "extent", [low - margin, high + margin]);
  }

  function zoomAbout(chart, time, factor) {
    const [first, last] = chart.span || [chart.times[0], chart.times[chart.times.length - 1]];
    zoom(chart, [time - (time - first) * factor, time + (last - time) * factor]);
  }

  // ---- reading values ---------------------------------------------------------------------------------
  function place(chart, x, y) {
    const box = chart.box.getBoundingClientRect();
    const note = chart.reading;
    const left = x + 16 + note.offsetWidth > box.width ? x - 16 - note.offsetWidth : x + 16;
    note.style.left = Math.max(0, left) + "px";
    note.style.top = Math.max(0, y) + "px";
  }

  function read(chart, index) {
    const data = page.data[chart.data];
    const note = chart.reading;
    chart.index = index;
    note.replaceChildren(element("b", "", "t = " + written(data.t[index], "s")));
    if (data.r) line(note, "var(--ink)", "reference", written(data.r[index], chart.unit));
    for (const [name, label] of Object.entries(chart.lines)) {
      if (!hidden[chart.group].has(name)) line(note, colour(name), label, written(data[name][index], chart.unit));
    }
    note.hidden = false;
    place(chart, chart.view.origin()[0] + chart.view.scale("x")(data.t[index]), 8);
    tell(sameFigure(chart), "at", data.t[index]);
  }

  function colour(name) {
    return "var(--c" + (Number(name.slice(1)) % page.colours) + ")";
  }

  function line(note, paint, label, value) {
    const row = element("div");
    const dot = element("i");
    dot.style.background = paint;
    row.append(dot, element("span", "", label), element("span", "", value));
    note.append(row);
  }

  function forget(chart) {
    chart.reading.hidden = true;
    tell(sameFigure(chart), "at", null);
  }

  // ---- pointer and keys on a chart over time ----------------------------------------------------------
  function timeAt(chart, event) {
    const left = chart.live.getBoundingClientRect().left + chart.view.origin()[0];
    return chart.view.scale("x").invert(event.clientX - left);
  }

  function listenOverTime(chart) {
    const live = chart.live;
    let from = null;
    live.addEventListener("pointerdown", (event) => {
      if (event.button === 0 && event.pointerType !== "touch") from = timeAt(chart, event);
    });
    live.addEventListener("pointermove", (event) => {
      const time = timeAt(chart, event);
      read(chart, nearest(chart.times, time));
      if (from !== null) tell(sameFigure(chart), "band", [Math.min(from, time), Math.max(from, time)]);
    });
    window.addEventListener("pointerup", (event) => {
      if (from === null) return;
      const span = [from, timeAt(chart, event)].sort((a, b) => a - b);
      from = null;
      tell(sameFigure(chart), "band", null);
      forget(chart);
      zoom(chart, span);
    });
    live.addEventListener("pointerleave", () => forget(chart));
    live.addEventListener("dblclick", () => zoom(chart, null));
    live.addEventListener("wheel", (event) => {
      // The wheel alone belongs to the page: a report is scrolled far more often than a chart is zoomed.
      if (!event.ctrlKey && !event.shiftKey && !event.metaKey) return;
      event.preventDefault();
      zoomAbout(chart, timeAt(chart, event), event.deltaY + event.deltaX > 0 ? 1.25 : 0.8);
    }, { passive: false });
    live.addEventListener("keydown", (event) => onKey(chart, event));
    live.addEventListener("blur", () => forget(chart));
  }

  function onKey(chart, event) {
    const steps = { ArrowLeft: -1, ArrowRight: 1 };
    const last = chart.times.length - 1;
    const index = chart.index === undefined ? 0 : chart.index;
    if (event.key in steps) read(chart, Math.min(last, Math.max(0, index + steps[event.key] * (event.shiftKey ? 10 : 1))));
    else if (event.key === "+" || event.key === "=") zoomAbout(chart, chart.times[index], 0.8);
    else if (event.key === "-") zoomAbout(chart, chart.times[index], 1.25);
    else if (event.key === "Escape") { zoom(chart, null); forget(chart); }
    else return;
    event.preventDefault();
  }

  function listenToMarks(chart) {
    chart.view.addEventListener("pointermove", (event, item) => {
      const text = item && item.datum && item.datum.text;
      chart.reading.hidden = !text;
      if (!text) return;
      const box = chart.box.getBoundingClientRect();
      chart.reading.textContent = text;
      place(chart, event.clientX - box.left, event.clientY - box.top + 12);
    });
    chart.live.addEventListener("pointerleave", () => { chart.reading.hidden = true; });
  }

  // ---- making the charts ------------------------------------------------------------------------------
  function prepare(box) {
    const told = page.views[box.dataset.view];
    const live = element("div", "live");
    const reading = element("div", "reading");
    reading.hidden = true;
    reading.setAttribute("role", "status");
    live.setAttribute("role", "img");
    live.setAttribute("aria-label", box.dataset.label);
    if (told.data) live.tabIndex = 0;
    hidden[told.group] = hidden[told.group] || new Set();
    return { ...told, box, live, reading, times: told.data ? page.data[told.data].t : null, span: null };
  }

  async function draw(box) {
    const chart = prepare(box);
    const spec = { ...chart.spec, width: "container", autosize: { type: "fit-x", contains: "padding" } };
    if (chart.data) spec.datasets = { ...spec.datasets, [chart.data]: rowsOf(page.data[chart.data]) };
    box.append(chart.live, chart.reading);
    box.classList.add("is-live");
    const options = { mode: "vega-lite", renderer: "svg", actions: false, ast: true, config: page.config, defaultStyle: false, tooltip: false, logLevel: 1 };
    try {
      chart.view = (await vegaEmbed(chart.live, spec, options)).view;
    } catch (error) {
      box.classList.remove("is-live");
      chart.live.remove();
      throw error;
    }
    // The label of the box says what the drawing shows; its parts say nothing more.
    chart.live.querySelector("svg").setAttribute("aria-hidden", "true");
    charts.push(chart);
    if (chart.times) listenOverTime(chart);
    else listenToMarks(chart);
    return chart;
  }

  // What is folded has no width before it is opened; then it shows what its neighbours show.
  function drawOnceOpen(fold) {
    fold.addEventListener("toggle", async () => {
      for (const box of fold.querySelectorAll(".chart")) {
        const chart = await draw(box);
        chart.span = together(chart)[0].span;
        tell([chart], "span", chart.span);
        tell([chart], "hidden", [...hidden[chart.group]]);
        fit(chart);
      }
      fold.dataset.ready = "yes";
    }, { once: true });
  }

  // ---- legends, tables, contents, theme ---------------------------------------------------------------
  function enableLegend(button) {
    button.disabled = false;
    button.addEventListener("click", () => {
      const { group, name } = button.dataset;
      const set = hidden[group];
      if (!set.delete(name)) set.add(name);
      for (const twin of document.querySelectorAll("button.entry")) {
        if (twin.dataset.group === group && twin.dataset.name === name) twin.setAttribute("aria-pressed", String(!set.has(name)));
      }
      const mine = charts.filter((chart) => chart.group === group);
      tell(mine, "hidden", [...set]);
      mine.filter((chart) => chart.times).forEach(fit);
    });
  }

  function valueOf(row, column) {
    const cell = row.cells[column];
    const number = cell.dataset.value;
    return number === undefined ? cell.textContent.trim() : number === "nan" ? Infinity : Number(number);
  }

  function sortBy(table, column) {
    const head = table.tHead.rows[0].cells[column];
    const order = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    for (const cell of table.tHead.rows[0].cells) cell.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", order > 0 ? "ascending" : "descending");
    const body = table.tBodies[0];
    const rows = [...body.rows].map((row) => [valueOf(row, column), row]);
    rows.sort(([a], [b]) => order * (typeof a === "number" ? (a === b ? 0 : a - b) : a.localeCompare(b)));
    body.append(...rows.map(([, row]) => row));
  }

  function enableSorting(table) {
    [...table.tHead.rows[0].cells].forEach((cell, column) => {
      const button = element("button", "sort");
      button.type = "button";
      button.append(...cell.childNodes);
      button.addEventListener("click", () => sortBy(table, column));
      cell.append(button);
    });
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
    button.hidden = false;
    button.addEventListener("click", () => {
      chosen = (chosen + 1) % themes.length;
      if (chosen) document.documentElement.dataset.theme = themes[chosen];
      else delete document.documentElement.dataset.theme;
      button.querySelector("span").textContent = themes[chosen];
    });
  }

  for (const columns of Object.values(page.data)) {
    for (const [name, packed] of Object.entries(columns)) columns[name] = unpacked(packed);
  }
  document.querySelectorAll(".help").forEach((help) => { help.hidden = false; });
  document.querySelectorAll("table.sortable").forEach(enableSorting);
  document.querySelectorAll("button.theme").forEach(enableTheme);
  document.querySelectorAll("details").forEach(drawOnceOpen);
  followContents();
  Promise.all([...document.querySelectorAll(".chart:not(details .chart)")].map(draw)).then(() => {
    document.querySelectorAll("button.entry").forEach(enableLegend);
    document.documentElement.dataset.ready = "yes";
  });
})();
