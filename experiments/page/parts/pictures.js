// Pictures: a single one, or several that are flipped through with a slider, its arrow keys, or buttons.

function figureOf(group) {
  const image = element("img");
  const name = element("figcaption", { role: "status" });
  const link = element("a");
  const last = group.pictures.length - 1;
  let number = 0;
  const slider = element("input", {
    type: "range", min: "0", max: String(last), value: "0", step: "1", "aria-label": group.title, oninput: () => show(Number(slider.value)),
  });
  const back = element("button", { type: "button", onclick: () => show(number - 1) }, "Previous");
  const on = element("button", { type: "button", onclick: () => show(number + 1) }, "Next");

  function show(next) {
    number = Math.min(Math.max(next, 0), last);
    const [file, uri] = group.pictures[number];
    const place = last ? `${number + 1} of ${last + 1}: ` : "";
    image.src = uri;
    image.alt = file;
    link.href = `./${encodeURIComponent(file)}`;
    link.textContent = file;
    name.replaceChildren(place, link);
    slider.value = String(number);
    slider.setAttribute("aria-valuetext", `${place}${file}`);
    back.disabled = number === 0;
    on.disabled = number === last;
  }

  show(0);
  const flip = last ? [element("h3", {}, group.title), element("div", { class: "flip" }, slider, back, on)] : [];
  return element("figure", {}, ...flip, image, name);
}
