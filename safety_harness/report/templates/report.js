"use strict";
for (const heading of document.querySelectorAll(".again > th")) {  // the name of the row above, which a filter may hide
  heading.append(...[...heading.parentElement.previousElementSibling.cells[0].childNodes].map((one) => one.cloneNode(true)));
}
const rows = new Map();  // of each table, also those that are not shown
const rowsOf = (table) => rows.get(table) ?? rows.set(table, [...table.tBodies[0].rows]).get(table);
// A number as people write it, with its unit or another number after it; "" where there is none.
const amount = (text) => text.replace("\u2212", "-").replace(/,/g, "").match(/^[-+]?[\d.]+/)?.[0] ?? "";
const shows = new Map();  // what lays out the rows of a table again
for (const table of document.querySelectorAll("table.sortable")) {
  shows.set(table, () => table.tBodies[0].append(...rowsOf(table)));
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
      const number = heading.classList.contains("number");
      const key = ({ cells: { [column]: cell } }) => cell.dataset.sort ?? cell.dataset.value ?? (number ? amount : String)(cell.textContent.trim());
      const compare = (a, b) => {
        const x = key(a), y = key(b);
        if (x === "" || y === "") return (x === "") - (y === "");
        const order = isNaN(x) || isNaN(y) ? x.localeCompare(y) : x - y;
        return down ? -order : order;
      };
      rowsOf(table).sort(compare);
      shows.get(table)();
    });
  });
}
// A filter before each table that asks for one: a text, and a value of each column whose heading asks for it.  It stands
// in the address after "#", where a page that is a file may write.  Only rows that are shown are in the document, and of
// more than MOST_ROWS the first; a browser that has to lay out ten thousand does not keep up with typing.
const narrow = matchMedia("(max-width: 56rem)");
const MOST_ROWS = narrow.matches ? 40 : 100, FEWEST_ROWS = 6;
const forms = [];
for (const table of document.querySelectorAll("table[data-filter]")) {
  const rows = rowsOf(table), body = table.tBodies[0];
  if (rows.length < FEWEST_ROWS) continue;
  const headings = [...table.tHead.rows[0].cells];
  const values = new Map(rows.map((row) => [row, []]));
  const value = (row, column) => values.get(row)[column] ??= (({ cells: { [column]: cell } }) =>
    cell.dataset.value ?? (cell.querySelector("a, .claim > :last-child") ?? cell).textContent.trim())(row);
  const texts = new Map();
  const text = (row) => texts.get(row) ?? texts.set(row, row.textContent.toLowerCase()).get(row);
  const form = document.createElement("form"), count = document.createElement("output"), number = forms.push(form);
  form.className = "filter";
  const part = table.closest("article")?.querySelector("h2, h3");
  form.setAttribute("aria-label", `Filter: ${table.caption.textContent.split(/[.:]/)[0]}${part ? `, ${part.textContent.trim()}` : ""}`);
  const field = (name, control) => {
    const label = document.createElement("label");
    control.name = name.toLowerCase() + (number > 1 ? `-${number}` : "");
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
  let most = MOST_ROWS;
  const show = () => {
    const words = find.value.toLowerCase().split(/\s+/).filter(Boolean);
    const wanted = choices.filter(([select]) => select.value).map(([select, column]) => [column, select.value]);
    const found = rows.filter((row) => wanted.every(([column, one]) => value(row, column) === one)
      && words.every((word) => text(row).includes(word)));
    const all = found.length === rows.length;
    body.replaceChildren(...found.slice(0, most));
    table.classList.toggle("filtered", !all);
    clear.disabled = all && !find.value;
    more.hidden = found.length <= most;
    count.textContent = (all ? `${rows.length} rows` : `${found.length} of ${rows.length} rows`)
      + (found.length > most ? `, the first ${most} shown` : "");
  };
  const told = () => {
    const asked = new URLSearchParams(forms.flatMap((one) => [...new FormData(one)]).filter(([, one]) => one)).toString();
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
  shows.set(table, show);
  addEventListener("beforeprint", () => { most = Infinity; show(); });
  form.addEventListener("reset", () => setTimeout(() => { show(); told(); find.focus(); }));
  form.addEventListener("submit", (event) => event.preventDefault());
  addEventListener("hashchange", read);
  table.classList.add("ready");  // until then a long table is not laid out beyond its first rows
  show();
  read();
}
addEventListener("keydown", (event) => {
  if (event.key !== "/" || !forms.length || event.target.closest("input, select, textarea, [role=application]")) return;
  event.preventDefault();
  forms[0].elements.find.focus();
});
// On a narrow screen rows become cards: then each cell says its heading, and what a table's parts are is said too.
const label = () => {
  if (!narrow.matches) return;
  narrow.removeEventListener("change", label);
  for (const table of document.querySelectorAll("table.cards")) {
    const names = [...table.tHead.rows[0].cells].map((heading) => heading.textContent);
    table.setAttribute("role", "table");
    for (const part of [table.tHead, ...table.tBodies]) part.setAttribute("role", "rowgroup");
    for (const row of [table.tHead.rows[0], ...rowsOf(table)]) {
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
