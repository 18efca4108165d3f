"use strict";
// Every cell of a table gets the name of its column, which narrow windows show beside it.
document.querySelectorAll("main table").forEach((table) => {
  const names = Array.from(table.querySelectorAll("thead th"), (th) => th.textContent);
  table.querySelectorAll("tbody tr").forEach((row) => Array.from(row.children).forEach((cell, i) => {
    if (cell.tagName === "TD" && names[i]) cell.dataset.name = names[i];
  }));
});
