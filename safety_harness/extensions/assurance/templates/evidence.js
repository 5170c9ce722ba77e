for (const table of document.querySelectorAll("table[data-copy]")) {
  const button = document.createElement("button");
  button.type = "button";
  button.className = "copy-button copy-table";
  button.textContent = "Copy table";
  table.before(button);
  button.addEventListener("click", async () => {
    const cells = (row) => [...row.cells].map((cell) => (cell.querySelector(".cell") ?? cell).textContent.trim().replace(/\s+/g, " "));
    const text = [...table.rows].map((row) => cells(row).join("\t")).join("\n");
    try {
      await navigator.clipboard.writeText(text);
      button.textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(table);
      button.textContent = "Selected";
    }
    button.dataset.copied = text;
    setTimeout(() => { button.textContent = "Copy table"; }, 2000);
  });
}
