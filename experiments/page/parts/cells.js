"use strict";
// What a cell is and how it is shown. Texts become text of the page, never markup.

const content = JSON.parse(document.getElementById("data").textContent);
const NOT_FINITE = { NaN: "nan", Infinity: "∞", "-Infinity": "-∞" };

/** An element with attributes, listeners (onclick and the like) and children; texts among these stay texts. */
function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") made.addEventListener(name.slice(2), value);
    else if (value !== false) made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children);
  return made;
}

/** A choice with its name above. */
function choice(name, options, chosen, onchange) {
  const select = element("select", { onchange: () => onchange(select.value) });
  for (const [value, text] of options) select.append(element("option", { value, selected: value === chosen }, text));
  return element("label", {}, name, select);
}

/** Something that is on or off. */
function check(name, checked, onchange) {
  const input = element("input", { type: "checkbox", checked, onchange: () => onchange(input.checked) });
  return element("label", { class: "check" }, input, name);
}

const isNumber = (column) => column.kind === "number";

/** A cell of a column of numbers as one: NaN for what is missing. */
const numberOf = (cell) => (cell === null ? NaN : Number(cell));

/** A cell as a reader sees it; whole numbers in groups of three, others with five digits or all of them. */
function shown(column, cell, allDigits = false) {
  if (cell === null) return "";
  if (!isNumber(column)) return cell;
  if (typeof cell === "string") return NOT_FINITE[cell] ?? cell;
  if (allDigits) return String(cell);
  return Number.isInteger(cell) ? cell.toLocaleString("en-GB") : String(Number(cell.toPrecision(5)));
}

/** Negative, zero or positive: which of two cells comes first. What is missing and NaN are no part of any order. */
function compared(column, one, other) {
  if (isNumber(column)) return numberOf(one) - numberOf(other) || 0;
  return one < other ? -1 : one > other ? 1 : 0;
}

const isMissing = (cell) => cell === null || cell === "NaN" || cell === "";

/** Values of a column in order, or null where there are more than so many. */
function valuesOf(column, most) {
  const found = new Set();
  for (const cell of column.cells) {
    found.add(cell);
    if (found.size > most) return null;
  }
  return [...found].sort((one, other) => isMissing(one) - isMissing(other) || compared(column, one, other));
}
