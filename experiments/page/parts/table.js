// The table: sorted by its headings, filtered by a text and by values, a page of rows at a time.

const MOST_VALUES = 40; // of a column that can be filtered by its values
const MOST_FILTERS = 8;
const LONG = 28; // letters of a cell that is broken into lines

class Table {
  /**
   * cases : names of the columns that say which case a row is of
   * onrows : hears the numbers of the rows that are left, whenever a filter changes
   */
  constructor(root, columns, count, cases, onrows) {
    this.columns = columns;
    this.cases = new Set(cases);
    this.count = columns.length ? columns[0].cells.length : 0;
    this.onrows = onrows;
    this.sort = { column: null, sign: 1 };
    this.page = 0;
    this.size = 50;
    this.wanted = new Map();
    this.find = "";
    this.constant = new Set(this.count > 1 ? columns.filter((own) => valuesOf(own, 1)) : []);
    this.head = element("thead");
    this.body = element("tbody");
    this.said = element("span", { role: "status" });
    this.back = element("button", { type: "button", onclick: () => this.turn(-1) }, "Previous rows");
    this.on = element("button", { type: "button", onclick: () => this.turn(1) }, "Next rows");
    const box = element("div", { class: "box", tabindex: "0", role: "region", "aria-label": "Table" });
    box.append(element("table", {}, this.head, this.body));
    root.append(this.controls(), this.everywhere(), this.pager(), box);
    if (count > this.count) {
      const kept = `The first ${this.count.toLocaleString("en-GB")} of ${count.toLocaleString("en-GB")} rows are on this page.`;
      root.prepend(element("p", { class: "notes" }, kept));
    }
    this.drawHead();
    this.filter();
  }

  controls() {
    let waiting = 0;
    const input = element("input", {
      type: "search",
      oninput: () => {
        clearTimeout(waiting);
        waiting = setTimeout(() => ((this.find = input.value.toLowerCase()), this.filter()), 120);
      },
    });
    const made = element("div", { class: "controls" }, element("label", {}, "Rows with the text", input));
    const repeated = this.columns.filter((own) => {
      const values = isNumber(own) && !this.cases.has(own.name) ? null : valuesOf(own, MOST_VALUES);
      return values && values.length > 1 && values.length < this.count;
    });
    for (const own of repeated.slice(0, MOST_FILTERS)) made.append(this.valueFilter(own));
    made.append(check("all digits", false, (on) => ((this.allDigits = on), this.drawBody())));
    if (this.constant.size)
      made.append(check("columns that never change", false, (on) => ((this.whole = on), this.drawHead(), this.drawBody())));
    return made;
  }

  valueFilter(column) {
    const values = valuesOf(column, MOST_VALUES);
    const options = values.map((cell, number) => [String(number), shown(column, cell) || "(empty)"]);
    return choice(column.name, [["", "all"], ...options], "", (value) => {
      if (value === "") this.wanted.delete(column);
      else this.wanted.set(column, values[Number(value)]);
      this.filter();
    });
  }

  /** What is the same in every row, in words. */
  everywhere() {
    const said = [...this.constant]
      .filter((own) => !isMissing(own.cells[0]))
      .map((own) => `${own.name} ${shown(own, own.cells[0])}`);
    return element("p", { class: "quiet" }, said.length ? `The same in every row: ${said.join(", ")}` : "");
  }

  pager() {
    const sizes = [50, 200, 1000].map((size) => [String(size), `${size} rows a page`]);
    const select = choice("", sizes, "50", (size) => ((this.size = Number(size)), (this.page = 0), this.drawBody()));
    select.firstElementChild.setAttribute("aria-label", "Rows a page");
    const turning = this.count > this.size ? [this.back, this.on, select] : [];
    return element("div", { class: "pager" }, this.said, ...turning);
  }

  turn(by) {
    this.page += by;
    this.drawBody();
  }

  get visible() {
    return this.columns.filter((own) => this.whole || !this.constant.has(own));
  }

  drawHead() {
    const cells = this.visible.map((column) => {
      const sorted = this.sort.column === column;
      const order = sorted ? (this.sort.sign > 0 ? "ascending" : "descending") : "none";
      const arrow = sorted ? (this.sort.sign > 0 ? " ▲" : " ▼") : " ↕";
      const button = element("button", { type: "button", onclick: () => this.sortBy(column) });
      const words = column.name.split("_");
      const last = element("span", { class: "whole" }, words.pop(), element("span", { "aria-hidden": "true", class: "arrow" }, arrow));
      button.append(...words.flatMap((word) => [`${word}_`, element("wbr")]), last);
      return element("th", { scope: "col", "aria-sort": order, class: isNumber(column) ? "number" : "text" }, button);
    });
    this.head.replaceChildren(element("tr", {}, ...cells));
  }

  /** Upwards, downwards, as it was. */
  sortBy(column) {
    const same = this.sort.column === column;
    this.sort = same && this.sort.sign < 0 ? { column: null, sign: 1 } : { column, sign: same ? -1 : 1 };
    const focused = [...this.head.querySelectorAll("button")].indexOf(document.activeElement);
    this.drawHead();
    this.head.querySelectorAll("button")[focused]?.focus();
    this.order();
  }

  filter() {
    const number = this.find.replaceAll(",", ""); // as it is shown, in groups of three
    const passes = (row) => {
      for (const [column, value] of this.wanted) if (column.cells[row] !== value) return false;
      if (!this.find) return true;
      return this.columns.some((own) => {
        const cell = own.cells[row];
        return cell !== null && String(cell).toLowerCase().includes(isNumber(own) ? number : this.find);
      });
    };
    this.rows = Array.from({ length: this.count }, (_, row) => row).filter(passes);
    this.onrows(this.rows);
    this.order();
  }

  order() {
    const { column, sign } = this.sort;
    this.sorted = this.rows;
    if (column) {
      const order = (one, other) =>
        isMissing(column.cells[one]) - isMissing(column.cells[other]) ||
        sign * compared(column, column.cells[one], column.cells[other]) ||
        one - other;
      this.sorted = [...this.rows].sort(order);
    }
    this.page = 0;
    this.drawBody();
  }

  drawBody() {
    const start = this.page * this.size;
    const rows = this.sorted.slice(start, start + this.size);
    const cell = (own, row) => {
      const text = shown(own, own.cells[row], this.allDigits);
      return element("td", { class: isNumber(own) ? "number" : text.length > LONG ? "text long" : "text" }, text);
    };
    this.body.replaceChildren(...rows.map((row) => element("tr", {}, ...this.visible.map((own) => cell(own, row)))));
    const number = (value) => value.toLocaleString("en-GB");
    const all = this.rows.length === this.count ? `${number(this.count)} rows` : `${number(this.rows.length)} of ${number(this.count)} rows`;
    this.said.textContent = rows.length ? `Rows ${number(start + 1)} to ${number(start + rows.length)}; ${all}` : `No row: ${all}`;
    this.back.disabled = this.page === 0;
    this.on.disabled = start + rows.length >= this.sorted.length;
  }
}
