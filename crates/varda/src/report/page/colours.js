"use strict";
// Colours of the page's figures, and a way to draw them again when they change.
const varda = window.varda = { data: JSON.parse(document.getElementById("data").textContent), redraw: [], drawn: 0, errors: [] };
addEventListener("error", (event) => varda.errors.push(event.message));

// A colour of the style sheet by name.
varda.colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

// The colour of a series by its style, as "analysis" or "line 2".
varda.ofStyle = (style) => {
  const [kind, i] = style.split(" ");
  return varda.colour(i === undefined ? kind : "c" + (Number(i) % 9));
};

// Scale viridis (Van der Walt and Smith 2015), 0 dark to 1 bright, as [red, green, blue] in 0 … 255.
varda.viridis = (x) => {
  const shades = [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129],
    [92, 200, 99], [170, 220, 50], [253, 231, 37]];
  const at = Math.min(Math.max(x, 0), 1) * (shades.length - 1);
  const i = Math.min(Math.floor(at), shades.length - 2);
  return shades[i].map((low, c) => Math.round(low + (at - i) * (shades[i + 1][c] - low)));
};

// A number in about four digits.
varda.short = (v) => {
  if (v === null || v === undefined || !Number.isFinite(v)) return "–";
  const size = Math.abs(v);
  const digits = Number(v.toPrecision(4));
  return size !== 0 && (size < 1e-3 || size >= 1e5) ? digits.toExponential().replace("e+", "e") : String(digits);
};

{
  const again = () => varda.redraw.forEach((draw) => draw());
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  // Paper is white, whatever the screen is.
  addEventListener("beforeprint", () => { document.documentElement.classList.add("paper"); again(); });
  addEventListener("afterprint", () => { document.documentElement.classList.remove("paper"); again(); });
}
