"use strict";
for (const heading of document.querySelectorAll(".again > th")) {  // the name of the row above, which a filter may hide
  heading.append(...[...heading.parentElement.previousElementSibling.cells[0].childNodes].map((one) => one.cloneNode(true)));
}
for (const table of document.querySelectorAll("table.sortable")) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.setAttribute("aria-label", "sort");
    heading.classList.add("sorts");
    heading.append(button);  // over the words and not around them: a printed page repeats words only
    button.addEventListener("click", () => {
      const down = heading.getAttribute("aria-sort") === "ascending";
      headings.forEach((other) => other.removeAttribute("aria-sort"));
      heading.setAttribute("aria-sort", down ? "descending" : "ascending");
      table.classList.add("sorted");
      const key = ({ cells: { [column]: cell } }) => cell.dataset.sort ?? cell.dataset.value ?? cell.textContent.trim();
      const compare = (a, b) => {
        const x = key(a), y = key(b);
        if (x === "" || y === "") return (x === "") - (y === "");
        const order = isNaN(x) || isNaN(y) ? x.localeCompare(y) : x - y;
        return down ? -order : order;
      };
      const body = table.tBodies[0];
      body.append(...[...body.rows].sort(compare));
      table.dispatchEvent(new Event("sorted"));
    });
  });
}
// A filter before each table that asks for one: a text, and a value of each column whose heading asks for it.  It stands
// in the address after "#", where a page that is a file may write.  More than MOST_ROWS are laid out only when asked for.
const narrow = matchMedia("(max-width: 56rem)");
const MOST_ROWS = narrow.matches ? 40 : 400;
for (const table of document.querySelectorAll("table[data-filter]")) {
  const headings = [...table.tHead.rows[0].cells];
  let rows = [...table.tBodies[0].rows];
  const value = (row, column) => {
    const cell = row.cells[column];
    return cell.dataset.value ?? (cell.querySelector("a") ?? cell).textContent.trim();
  };
  const form = document.createElement("form"), count = document.createElement("output");
  form.className = "filter";
  form.setAttribute("aria-label", "Filter");
  const field = (name, control) => {
    const label = document.createElement("label");
    control.name = name.toLowerCase();
    label.append(name, control);
    form.append(label);
    return control;
  };
  const find = field("Find", Object.assign(document.createElement("input"), { type: "search" }));
  const choices = headings.flatMap((heading, column) => {
    if (!("filter" in heading.dataset)) return [];
    const select = document.createElement("select");
    for (const one of ["", ...new Set(rows.map((row) => value(row, column)))]) select.add(new Option(one || "all", one));
    return [[field(heading.textContent, select), column]];
  });
  const button = (type, textContent) => Object.assign(document.createElement("button"), { type, textContent });
  const clear = button("reset", "Clear"), more = button("button", "Show all of them");
  form.append(clear, count);
  table.before(form);
  table.after(more);
  more.className = "more copy-button";
  let texts, values, most = MOST_ROWS;
  const show = () => {
    const words = find.value.toLowerCase().split(/\s+/).filter(Boolean);
    const wanted = choices.map(([select]) => select.value);
    if (words.length) texts ??= rows.map((row) => row.textContent.toLowerCase());
    if (wanted.some(Boolean)) values ??= choices.map(([, column]) => rows.map((row) => value(row, column)));
    let found = 0;
    rows.forEach((row, k) => {
      const is = wanted.every((one, c) => !one || values[c][k] === one) && words.every((word) => texts[k].includes(word));
      found += is;
      const hidden = !is || found > most;
      if (row.hidden !== hidden) row.hidden = hidden;
    });
    const all = found === rows.length;
    table.classList.toggle("filtered", !all);
    clear.disabled = all && !find.value;
    more.hidden = found <= most;
    count.textContent = (all ? `${found} rows` : `${found} of ${rows.length} rows`) + (found > most ? `, the first ${most} shown` : "");
  };
  const told = () => {
    const asked = new URLSearchParams([...new FormData(form)].filter(([, one]) => one)).toString();
    history.replaceState(null, "", asked ? `#${asked}` : location.pathname + location.search);
  };
  const read = () => {
    if (!location.hash.includes("=")) return;
    const asked = new URLSearchParams(location.hash.slice(1));
    for (const control of form.elements) if (control.name) control.value = asked.get(control.name) ?? "";
    show();
  };
  form.addEventListener("input", () => { show(); told(); });
  more.addEventListener("click", () => { most = Infinity; show(); });
  table.addEventListener("sorted", () => { rows = [...table.tBodies[0].rows]; texts = values = undefined; show(); });
  addEventListener("beforeprint", () => { most = Infinity; show(); });
  form.addEventListener("reset", () => setTimeout(() => { show(); told(); find.focus(); }));
  form.addEventListener("submit", (event) => event.preventDefault());
  addEventListener("hashchange", read);
  addEventListener("keydown", (event) => {
    if (event.key !== "/" || event.target.closest("input, select, textarea, [role=application]")) return;
    event.preventDefault();
    find.focus();
  });
  show();
  read();
}
// On a narrow screen rows become cards: then each cell says its heading, and what a table's parts are is said too.
const label = () => {
  if (!narrow.matches) return;
  narrow.removeEventListener("change", label);
  for (const table of document.querySelectorAll("table.cards")) {
    const names = [...table.tHead.rows[0].cells].map((heading) => heading.textContent);
    table.setAttribute("role", "table");
    for (const part of [table.tHead, ...table.tBodies]) part.setAttribute("role", "rowgroup");
    for (const row of table.rows) {
      row.setAttribute("role", "row");
      [...row.cells].forEach((cell, column) => {
        cell.setAttribute("role", cell.tagName === "TD" ? "cell" : cell.scope === "col" ? "columnheader" : "rowheader");
        if (cell.scope !== "col") cell.dataset.label = names[column];
      });
    }
  }
};
narrow.addEventListener("change", label);
label();
const unfold = () => {
  const id = new URLSearchParams(`id=${location.hash.slice(1)}`).get("id");  // decodes, and no address is an error
  const target = document.getElementById(id);
  for (let part = target; part; part = part.parentElement) if (part.tagName === "DETAILS") part.open = true;
  if (!target) return;
  target.querySelector(":scope > details")?.setAttribute("open", "");
  target.scrollIntoView();
};
addEventListener("hashchange", unfold);
unfold();
for (const code of document.querySelectorAll("code.copy")) {
  const button = document.createElement("button");
  button.type = "button";
  button.className = "copy-button";
  button.textContent = "Copy";
  code.after(button);
  button.addEventListener("click", async () => {
    getSelection().selectAllChildren(code);
    try {
      await navigator.clipboard.writeText(code.textContent);
      button.textContent = "Copied";
    } catch {
      button.textContent = "Selected";
    }
    setTimeout(() => { button.textContent = "Copy"; }, 2000);
  });
}
addEventListener("beforeprint", () => {
  document.querySelectorAll("details").forEach((part) => { part.open = true; });
});
