"use strict";
// The ranking against a controller that the reader chooses: differences and what is told of them are in the page.
(function () {
  function element(tag, className, text) {
    const made = document.createElement(tag);
    if (className) made.className = className;
    if (text !== undefined) made.textContent = text;
    return made;
  }

  // The cells of a column, one for each row; a column that the page does not have yet is made beside the ranks.
  function columnsOf(table, details) {
    const rows = [...table.tBodies[0].rows];
    const head = [...table.tHead.rows];
    const titles = head.at(-1).cells;
    const made = !rows[0].querySelector("td.versus");
    const beside = rows[0].querySelector("td.rank") || rows[0].querySelector("td.drawn") || rows[0].cells[0];
    const first = made ? beside.cellIndex + 1 : rows[0].querySelector("td.versus").cellIndex;
    if (made) {
      details.forEach((_, place) => {
        for (const row of head.slice(0, -1)) row.insertBefore(element("td"), row.cells[first + place]).hidden = true;
        const title = element("th", "n");
        title.scope = "col";
        head.at(-1).insertBefore(title, titles[first + place]);
        for (const row of rows) row.insertBefore(element("td", "versus"), row.cells[first + place]);
      });
    }
    return details.map((detail, place) => {
      const title = titles[first + place];
      const words = element("span");
      title.replaceChildren(words, ...(detail ? [element("small", "", detail)] : []));
      const others = head.slice(0, -1).map((row) => row.cells[first + place]);
      return { title, words, others, made, cells: rows.map((row) => row.cells[first + place]) };
    });
  }

  function show(columns, label, pairs) {
    columns.forEach(({ title, words, others, made, cells }, place) => {
      words.textContent = label ? "against " + label : "against";
      for (const cell of [title, ...(made ? others : []), ...cells]) cell.hidden = !label;
      if (!label) return;
      cells.forEach((cell, row) => {
        const [text, tone, value] = pairs[row][place];
        cell.className = tone;
        cell.dataset.value = value === null ? "nan" : value;
        cell.textContent = text;
      });
    });
  }

  function enable(box) {
    const table = document.getElementById(box.dataset.table + "-table");
    const select = box.querySelector("select");
    const { details, pairs } = JSON.parse(box.dataset.against);
    const columns = columnsOf(table, details);
    const labels = Object.fromEntries([...select.options].map((option) => [option.value, option.textContent]));
    select.value = box.dataset.chosen; // a browser that goes back keeps another one
    const choose = () => show(columns, select.value && labels[select.value], pairs[select.value]);
    // The reader chooses, or the address does.
    for (const kind of ["change", "chosen"]) select.addEventListener(kind, choose);
    choose();
    box.hidden = false;
  }

  // Before tables are made to sort: columns keep their places.
  document.addEventListener("DOMContentLoaded", () => document.querySelectorAll(".against").forEach(enable));
})();
