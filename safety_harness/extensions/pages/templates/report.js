"use strict";
for (const part of document.querySelectorAll("h1, h2, h3, .meta, .banner, .answer")) {  // no line ends between a number and its unit
  for (const text = document.createTreeWalker(part, NodeFilter.SHOW_TEXT); text.nextNode();) {
    const node = text.currentNode;
    if (!node.parentElement.closest("code")) node.data = node.data.replace(/(\d) (?=(mm|m|ms|s|deg|Hz|%)(?![A-Za-z]))/g, "$1\u00a0");
  }
}
for (const heading of document.querySelectorAll(".again > th")) {  // the name of the row above, which a filter may hide
  heading.append(...[...heading.parentElement.previousElementSibling.cells[0].childNodes].map((one) => one.cloneNode(true)));
}
// On a narrow screen rows become cards: then each cell says its heading, and what a table's parts are is said too.
let labelled = false;
const labelRow = (row, table) => {
  row.setAttribute("role", "row");
  [...row.cells].forEach((cell, column) => {
    cell.setAttribute("role", cell.tagName === "TD" ? "cell" : cell.scope === "col" ? "columnheader" : "rowheader");
    if (cell.scope !== "col") cell.dataset.label = table.tHead.rows[0].cells[column].textContent;
  });
};
// A row of a table: in the document, or, of a long table, text until it is shown.
const plain = (markup) => markup.replace(/<[^>]*>/g, "").replace(/&(#3[49]|[lg]t|amp);/g, (name) => (
  { "&#34;": '"', "&#39;": "'", "&lt;": "<", "&gt;": ">", "&amp;": "&" }[name]));
class Row {
  constructor(table, element, markup) { Object.assign(this, { table, made: element, markup }); }
  has(word) {  // markup that lacks a word need not be read
    const near = this.text ?? (this.made || /[&<>"']/.test(word) ? this.words : (this.lower ??= this.markup.toLowerCase()));
    return near.includes(word) && this.words.includes(word);
  }
  get words() { return (this.text ??= (this.made?.textContent ?? plain(this.markup)).toLowerCase()); }
  get element() {
    if (this.made) return this.made;
    const body = document.createElement("tbody");
    body.innerHTML = this.markup;
    this.made = body.rows[0];
    if (labelled) labelRow(this.made, this.table);
    return this.made;
  }
  cell(column) {  // what it sorts and filters by, and its words
    if (this.made) {
      const cell = this.made.cells[column], { sort, value } = cell.dataset;
      return { sort, value, link: cell.querySelector("a")?.textContent, words: cell.textContent };
    }
    const markup = (this.cells ??= this.markup.split(/<\/t[dh]>/))[column];
    const found = (pattern) => { const one = markup.match(pattern)?.[1]; return one === undefined ? one : plain(one); };
    return { sort: found(/^[^>]* data-sort="([^"]*)"/), value: found(/^[^>]* data-value="([^"]*)"/), link: found(/<a [^>]*>(.*?)<\/a>/), words: plain(markup) };
  }
}
const rows = new Map();  // of each table, also those that are not shown
const laterRows = (table) => {
  const later = table.nextElementSibling;
  if (!later?.matches("noscript.rows")) return [];
  let named = "";  // the heading of the row above
  return later.textContent.split("<tbody>")[1].split("</tr>").slice(0, -1).map((markup) => {
    const [whole, empty] = markup.match(/<th scope="row">(.*?)<\/th>/s);
    if (empty) named = whole;
    return new Row(table, null, empty ? markup : markup.replace(whole, () => named));
  });
};
const rowsOf = (table) => rows.get(table)
  ?? rows.set(table, [...[...table.tBodies[0].rows].map((row) => new Row(table, row)), ...laterRows(table)]).get(table);
// A number as people write it, with its unit or another number after it, ms as seconds; "" where there is none.
const amount = (text) => {
  const [, number = "", milli] = text.replace("\u2212", "-").replace(/,/g, "").match(/^([-+]?[\d.]+)(\s*ms\b)?/) ?? [];
  return milli ? String(number / 1e3) : number;
};
const shows = new Map();  // what lays out the rows of a table again
for (const table of document.querySelectorAll("table.sortable")) {
  shows.set(table, () => table.tBodies[0].append(...rowsOf(table).map((row) => row.element)));
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
      const key = (row) => (({ sort, value, words }) => sort ?? value ?? (number ? amount : String)(words.trim()))(row.cell(column));
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
const MOST_ROWS = narrow.matches ? 40 : 100, FIRST_ROWS = 40, FEWEST_ROWS = 6;
const MOST_CHOICES = 200;  // of a list to choose from; of a column with more, words are asked for
const forms = [];
for (const table of document.querySelectorAll("table[data-filter]")) {
  const rows = rowsOf(table), body = table.tBodies[0];
  if (rows.length < FEWEST_ROWS) continue;
  const headings = [...table.tHead.rows[0].cells];
  const values = new Map(rows.map((row) => [row, []]));
  const value = (row, column) => values.get(row)[column] ??= (({ value, link, words }) => value ?? (link ?? words).trim())(row.cell(column));
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
    const all = new Set(rows.map((row) => value(row, column)));
    if (all.size > MOST_CHOICES) return [[field(heading.textContent, Object.assign(document.createElement("input"), { type: "search" })), column]];
    const select = document.createElement("select");
    for (const one of ["", ...all]) select.add(new Option(one || "all", one));
    return [[field(heading.textContent, select), column]];
  });
  const button = (type, textContent) => Object.assign(document.createElement("button"), { type, textContent });
  const clear = button("reset", "Clear"), more = button("button", "Show all rows");
  form.append(clear, count);
  table.before(form);
  table.after(more);
  more.className = "more copy-button";
  let whole = false;  // all rows are shown, however many
  const show = () => {
    const words = find.value.toLowerCase().split(/\s+/).filter(Boolean);
    const wanted = choices.filter(([control]) => control.value).map(([{ type, value: asked }, column]) => (type === "search"
      ? (row) => value(row, column).toLowerCase().includes(asked.toLowerCase()) : (row) => value(row, column) === asked));
    const found = rows.filter((row) => wanted.every((one) => one(row))
      && words.every((word) => row.has(word)));
    const all = found.length === rows.length, most = whole || found.length <= MOST_ROWS ? found.length : FIRST_ROWS;
    body.replaceChildren(...found.slice(0, most).map((row) => row.element));
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
  const read = (event) => {
    if (!location.hash.includes("=")) return;
    const asked = new URLSearchParams(location.hash.slice(1));
    for (const control of form.elements) if (control.name) control.value = asked.get(control.name) ?? "";
    show();
    if (event && !clear.disabled) form.scrollIntoView();  // a link led here
  };
  form.addEventListener("input", () => { show(); told(); });
  more.addEventListener("click", () => { whole = true; show(); });
  shows.set(table, show);
  addEventListener("beforeprint", () => { whole = true; show(); });
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
const label = () => {
  if (!narrow.matches) return;
  narrow.removeEventListener("change", label);
  labelled = true;
  for (const table of document.querySelectorAll("table.cards")) {
    table.setAttribute("role", "table");
    for (const part of [table.tHead, ...table.tBodies]) part.setAttribute("role", "rowgroup");
    for (const row of [table.tHead.rows[0], ...rowsOf(table).map((one) => one.made).filter(Boolean)]) labelRow(row, table);
  }
};
narrow.addEventListener("change", label);
label();
// Runs that are not drawn are text too, until the browser has time, or one of them is asked for.
const laterRuns = new Set(document.querySelectorAll("noscript.runs"));
const readRuns = (one) => {
  if (!laterRuns.delete(one)) return;
  const part = document.createElement("div");
  part.className = "runs";
  part.innerHTML = one.textContent;
  one.replaceWith(part);
};
const readMore = () => {
  for (const one of laterRuns) { readRuns(one); break; }
  if (laterRuns.size) requestIdleCallback(readMore);
};
if (laterRuns.size) addEventListener("load", () => (window.requestIdleCallback ? requestIdleCallback(readMore) : laterRuns.forEach(readRuns)));
const unfold = () => {
  const id = new URLSearchParams(`id=${location.hash.slice(1)}`).get("id");  // decodes, and no address is an error
  for (const one of laterRuns) if (id && one.textContent.includes(` id="${id}" `)) readRuns(one);
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
  laterRuns.forEach(readRuns);
  document.querySelectorAll("details").forEach((part) => { part.open = true; });
});
