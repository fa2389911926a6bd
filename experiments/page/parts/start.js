// The page as it is when it is opened.

const inside = (id) => document.querySelector(`#${id} .content`);
const drop = (id) => {
  document.getElementById(id).remove();
  document.querySelector(`nav a[href="#${id}"]`)?.remove();
};

const [front, ...others] = content.front ? content.groups : [null, ...content.groups];
if (front) document.getElementById("first").append(figureOf(front));
inside("pictures").append(...others.map(figureOf));
if (!others.length && !document.querySelector("#pictures .notes")) drop("pictures");

const charts = content.charts.map((spec) => new Chart(inside("charts"), spec, content.columns, content.looks));
if (!charts.length) drop("charts");
let drawing = 0;
const redraw = (rows) => {
  clearTimeout(drawing);
  drawing = setTimeout(() => charts.forEach((own) => own.draw(rows)), 0);
};
if (content.columns.length) new Table(inside("table"), content.columns, content.rows, content.cases, redraw);
else inside("table").append(element("p", {}, "The table has no rows."));
