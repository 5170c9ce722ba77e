// A coverage map is walked cell by cell, with one stop of the keyboard; what a cell counts is told in words.
for (const map of document.querySelectorAll("svg[aria-labelledby*='coverage-']")) {
  const cells = [...map.querySelectorAll("g:has(> title)")];
  if (!cells.length) continue;
  const label = document.createElement("label"), walk = document.createElement("input"), says = document.createElement("output");
  Object.assign(walk, { type: "range", min: 0, max: cells.length - 1, value: 0 });
  label.className = "cells";
  label.append(`${cells.length} cells with runs`, walk, says);
  map.parentElement.after(label);
  const tell = (cell) => {
    walk.value = cells.indexOf(cell);
    cells.forEach((one) => one.classList.toggle("told", one === cell));
    says.textContent = cell.querySelector("title").textContent;
    walk.setAttribute("aria-valuetext", says.textContent);
  };
  walk.addEventListener("input", () => tell(cells[walk.value]));
  map.addEventListener("pointerover", ({ target }) => {
    const cell = target.closest("g");
    if (cells.includes(cell)) tell(cell);
  });
  tell(cells[0]);
}
