// Charts of columns that the reader chooses, drawn by Bokeh: a colour and a mark a value, a panel a value.

const MOST_POINTS = 20000; // that are drawn
const MOST_ACROSS = 40; // texts along an axis
const INK = "#303030";
const OTHERS = "(others)";

/** Text as Bokeh takes it for text, not for a formula. */
const plain = (text) => text.replaceAll("$$", "$\u200b$").replaceAll("\\[", "\\\u200b[").replaceAll("\\(", "\\\u200b(");
const short = (text, most = 28) => (text.length > most ? `${text.slice(0, most - 1)}…` : text);

class Chart {
  constructor(root, spec, columns, looks) {
    this.spec = { ...spec };
    this.columns = columns;
    this.looks = looks;
    this.off = new Set();
    this.views = [];
    this.drawn = false; // whether all of it is
    this.said = element("p", { class: "quiet", role: "status" });
    this.legend = element("ul", { class: "legend", "aria-label": "Series: press to hide or show" });
    this.panels = element("div", { class: "panels" });
    const box = element("div", { class: "chart", role: "group" }, this.controls(), this.legend, this.panels, this.said);
    root.append(box);
  }

  column(name) {
    return this.columns.find((own) => own.name === name) ?? null;
  }

  controls() {
    const numbers = this.columns.filter(isNumber);
    const few = (most) => this.columns.filter((own) => (valuesOf(own, most) ?? []).length > 1);
    const across = [...numbers, ...few(MOST_ACROSS).filter((own) => !isNumber(own))];
    const options = (columns) => columns.map((own) => [own.name, own.name]);
    const none = [["", "none"]];
    const set = (key) => (value) => {
      this.spec[key] = value === "" ? null : value;
      if (key === "series") this.off.clear();
      if (key !== "join") this.spec.join = undefined;
      this.draw(this.rows);
    };
    const made = element("div", { class: "controls" });
    made.append(
      choice("across", options(across), this.spec.x, set("x")),
      choice("up", options(numbers), this.spec.y, set("y")),
      choice("colour and mark", [...none, ...options(few(this.looks.mostSeries * 4))], this.spec.series ?? "", set("series")),
      choice("a panel each", [...none, ...options(few(12))], this.spec.panel ?? "", set("panel")),
      check("logarithmic across", this.spec.logX, set("logX")),
      check("logarithmic up", this.spec.logY, set("logY")),
    );
    this.join = check("join points", false, set("join"));
    made.append(this.join);
    return made;
  }

  /** Points of rows: what goes across and up, or nothing where one of them has no place. */
  points(rows) {
    const [x, y] = [this.column(this.spec.x), this.column(this.spec.y)];
    const place = (column, log, cell) => {
      if (!isNumber(column)) return cell === null ? null : cell;
      const value = numberOf(cell);
      return Number.isFinite(value) && (!log || value > 0) ? value : null;
    };
    const found = [];
    for (const row of rows) {
      const own = { row, x: place(x, this.spec.logX, x.cells[row]), y: place(y, this.spec.logY, y.cells[row]) };
      if (own.x !== null && own.y !== null) found.push(own);
    }
    return found;
  }

  /** The values that series are of, and the look of each: the same whatever is filtered. */
  series() {
    const column = this.column(this.spec.series);
    const { colours, shapes, methods, mostSeries } = this.looks;
    if (!column) return { of: () => "", looks: new Map([["", { colour: colours[0], shape: shapes[0] }]]) };
    const values = valuesOf(column, Infinity);
    const looks = new Map();
    const taken = new Set();
    for (const value of values.slice(0, mostSeries)) {
      const name = shown(column, value) || "(empty)";
      const own = Object.hasOwn(methods, name) ? methods[name] : null;
      if (!own || taken.has(String(own))) continue;
      taken.add(String(own));
      looks.set(value, { name, colour: own[0], shape: own.slice(1) });
    }
    let number = 0;
    for (const value of values.slice(0, mostSeries)) {
      if (looks.has(value)) continue;
      let own;
      do own = [colours[number % colours.length], ...shapes[number++ % shapes.length]];
      while (taken.has(String(own)));
      taken.add(String(own));
      looks.set(value, { name: shown(column, value) || "(empty)", colour: own[0], shape: own.slice(1) });
    }
    if (values.length > mostSeries) looks.set(OTHERS, { name: OTHERS, colour: "#b3b3b3", shape: shapes[0] });
    const ordered = new Map([...values, OTHERS].filter((value) => looks.has(value)).map((value) => [value, looks.get(value)]));
    return { of: (row) => (looks.has(column.cells[row]) ? column.cells[row] : OTHERS), looks: ordered };
  }

  /** Draw the rows. What was drawn before is thrown away. */
  async draw(rows) {
    this.rows = rows;
    this.drawn = false;
    const turn = (this.turn = {});
    let points = this.points(rows);
    const lost = rows.length - points.length;
    const step = Math.ceil(points.length / MOST_POINTS);
    const all = points.length;
    if (step > 1) points = points.filter((_, number) => number % step === 0);
    const series = this.series();
    this.drawLegend(series);
    points = points.filter((own) => !this.off.has(series.of(own.row)));
    const panel = this.column(this.spec.panel);
    const values = panel ? valuesOf(panel, Infinity) : [null];
    const groups = values.map((value) => [value, panel ? points.filter((own) => panel.cells[own.row] === value) : points]);
    this.settleJoin(points, series, panel);
    const views = [];
    const made = groups.filter(([, own]) => own.length).map(([value, own]) => {
      const drawn = element("div", { class: "drawn" });
      views.push([drawn, this.figure(own, points, series)]);
      const heading = panel ? [element("h3", {}, `${panel.name} ${shown(panel, value) || "(empty)"}`)] : [];
      return element("div", { class: "panel" }, ...heading, drawn);
    });
    this.forget();
    this.panels.replaceChildren(...made);
    this.panels.setAttribute("aria-label", `${this.spec.y} against ${this.spec.x}; the numbers are in the table`);
    const count = (number) => number.toLocaleString("en-GB");
    const said = [];
    if (!points.length) said.push("Nothing to draw.");
    if (step > 1) said.push(`Of ${count(all)} points every ${step}th is drawn.`);
    const rowsHave = lost === 1 ? "row has" : "rows have";
    if (lost) said.push(`${count(lost)} ${rowsHave} no place here: a number is missing or not finite, or not positive on a logarithmic axis.`);
    this.said.textContent = said.join(" ");
    for (const [drawn, figure] of views) {
      const view = await Bokeh.Plotting.show(figure, drawn);
      if (this.turn !== turn) return void this.end(view);
      this.views.push(view);
    }
    this.drawn = true;
  }

  forget() {
    for (const view of this.views) this.end(view);
    this.views = [];
  }

  end(view) {
    for (const own of [view].flat()) {
      const made = own.model.document;
      own.remove();
      const place = Bokeh.documents.indexOf(made);
      if (place >= 0) Bokeh.documents.splice(place, 1);
    }
  }

  /** Points are joined where a line has one of them at a place, unless the reader says otherwise. */
  settleJoin(points, series, panel) {
    const input = this.join.querySelector("input");
    input.disabled = !isNumber(this.column(this.spec.x));
    if (this.spec.join === undefined) {
      const places = new Set();
      const key = ({ row, x }) => JSON.stringify([x, series.of(row), panel ? panel.cells[row] : null]);
      input.checked = !input.disabled && points.length < 2000 && points.every((own) => places.size < places.add(key(own)).size);
    }
    this.joined = input.checked && !input.disabled;
  }

  drawLegend(series) {
    const column = this.column(this.spec.series);
    const items = [...(column ? series.looks : [])].map(([value, { name, colour, shape }]) => {
      const letter = element("span", { class: "shape", "aria-hidden": "true" }, shape[1]);
      letter.style.color = colour;
      const toggle = () => {
        if (!this.off.delete(value)) this.off.add(value);
        const place = [...this.legend.querySelectorAll("button")].indexOf(document.activeElement);
        this.draw(this.rows);
        this.legend.querySelectorAll("button")[place]?.focus();
      };
      const pressed = String(!this.off.has(value));
      return element("li", {}, element("button", { type: "button", "aria-pressed": pressed, onclick: toggle }, letter, name));
    });
    this.legend.replaceChildren(...items);
  }

  /** One panel. All panels have the same ranges. */
  figure(points, every, series) {
    const [x, y] = [this.column(this.spec.x), this.column(this.spec.y)];
    const named = this.namesAcross(x, every);
    const figure = Bokeh.Plotting.figure({
      height: 380,
      sizing_mode: "stretch_width",
      x_axis_type: isNumber(x) && this.spec.logX ? "log" : "auto",
      y_axis_type: this.spec.logY ? "log" : "auto",
      x_range: named ? new Bokeh.FactorRange({ factors: [...named.values()] }) : rangeOf(every.map((own) => own.x), this.spec.logX),
      y_range: rangeOf(every.map((own) => own.y), this.spec.logY),
      x_axis_label: plain(x.name),
      y_axis_label: plain(y.name),
      tools: ["pan", "box_zoom", "wheel_zoom", "reset", "save"],
      output_backend: "canvas",
    });
    figure.toolbar.logo = null;
    figure.toolbar.active_scroll = null;
    for (const axis of [...figure.xaxes, ...figure.yaxes]) {
      if (axis.formatter instanceof Bokeh.BasicTickFormatter) axis.formatter.power_limit_high = 8;
      axis.axis_label_text_font_style = "normal";
      axis.axis_label_text_font_size = "14px";
      axis.major_label_text_font_size = "13px";
    }
    if (named) for (const axis of figure.xaxes) axis.major_label_orientation = 0.7;
    for (const [value, look] of series.looks) {
      const own = points.filter(({ row }) => series.of(row) === value);
      if (own.length) this.drawSeries(figure, own, every.length, look, named);
    }
    figure.add_tools(new Bokeh.HoverTool({ tooltips: this.tips(), mode: "mouse", renderers: figure.renderers.filter((own) => own.name === "points") }));
    return figure;
  }

  namesAcross(x, points) {
    if (isNumber(x)) return null;
    const there = new Set(points.map((own) => own.x));
    const names = new Map();
    for (const value of valuesOf(x, Infinity).filter((own) => there.has(own))) {
      let name = plain(short(value || "(empty)"));
      while ([...names.values()].includes(name)) name += "′";
      names.set(value, name);
    }
    return names;
  }

  /** every: how many points there are in all panels; marks are the smaller the more there are. */
  drawSeries(figure, points, every, look, named) {
    const ordered = this.joined ? [...points].sort((one, other) => one.x - other.x) : points;
    const cells = (name) => {
      const column = this.column(name);
      return ordered.map(({ row }) => (column ? short(shown(column, column.cells[row]), 80) : ""));
    };
    const data = { x: ordered.map((own) => (named ? named.get(own.x) : own.x)), y: ordered.map((own) => own.y) };
    const told = this.tipNames();
    told.forEach((name, number) => (data[`tip${number}`] = cells(name)));
    const source = new Bokeh.ColumnDataSource({ data });
    const at = [{ field: "x" }, { field: "y" }];
    if (this.joined && ordered.length > 1) figure.line(...at, { source, line_color: look.colour, line_width: 1.5, line_alpha: 0.7 });
    const bare = look.shape[0] === "x";
    const size = every > 2000 ? 5 : every > 500 ? 7 : 10;
    figure.scatter(...at, {
      source,
      marker: look.shape[0],
      size: look.shape[0] === "star" ? 1.4 * size : size,
      fill_color: look.colour,
      fill_alpha: every > 500 ? 0.6 : 0.9,
      line_color: bare ? look.colour : INK,
      line_width: bare ? size / 3.3 : size / 14,
      name: "points",
    });
  }

  /** Columns that are told of a point: those of the chart, and what else says which row it is. */
  tipNames() {
    const { x, y, series, panel } = this.spec;
    const words = this.columns.filter((own) => !isNumber(own) && !valuesOf(own, 1)).map((own) => own.name);
    return [...new Set([series, panel, x, y, ...words].filter(Boolean))].slice(0, 8);
  }

  tips() {
    return this.tipNames().map((name, number) => [plain(name.replaceAll(/[@$]/g, "")), `@tip${number}`]);
  }
}

/** A range with room at its ends. */
function rangeOf(values, log) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) {
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  if (!(low <= high)) [low, high] = [log ? 1 : 0, log ? 10 : 1];
  if (log) {
    const by = high > low ? Math.min((high / low) ** 0.06, 10) : 2;
    return new Bokeh.Range1d({ start: low / by, end: high * by });
  }
  const by = high > low ? 0.06 * (high - low) : 0.1 * Math.abs(high) || 1;
  return new Bokeh.Range1d({ start: low - by, end: high + by });
}
