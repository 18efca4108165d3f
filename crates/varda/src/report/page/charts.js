"use strict";
// Draws the charts of the page with uPlot, and images on a canvas.
{
  const dashes = { truth: [3, 4], background: [8, 5] };
  const shown = (_, v) => (v === null ? "" : varda.short(v));
  const pointsOnly = ["observation", "withheld", "refused", "dots"];

  // Series share one column of x; where one has no value there is null.
  const joined = (panel) => {
    const tables = panel.series.map((s) => s.points);
    panel.bands.forEach((b) => tables.push([b.points[0], b.points[1]], [b.points[0], b.points[2]]));
    const sorted = tables.map(([x, y]) => {
      const order = x.map((_, i) => i).filter((i) => x[i] !== null).sort((a, b) => x[a] - x[b]);
      const keep = order.filter((i, k) => k === 0 || x[i] !== x[order[k - 1]]);
      const value = (i) => (panel.log_y && !(y[i] > 0) ? null : y[i]);
      return [keep.map((i) => x[i]), keep.map(value)];
    });
    const some = panel.log_x ? sorted.map(([x, y]) => {
      const from = x.findIndex((v) => v > 0);
      return from < 0 ? [[], []] : [x.slice(from), y.slice(from)];
    }) : sorted;
    return uPlot.join(some);
  };

  const ofSeries = (s) => {
    const kind = s.style.split(" ")[0];
    const colour = varda.ofStyle(s.style);
    const dots = pointsOnly.includes(kind);
    const show = dots || kind === "marked" || s.points[0].length === 1;
    return {
      label: s.label, stroke: colour, width: dots ? 0 : 2, dash: dashes[kind], spanGaps: true,
      paths: dots ? () => null : undefined,
      points: { show, size: kind === "dots" ? 4 : 6, fill: kind === "withheld" || kind === "refused" ? "transparent" : colour, stroke: colour },
      value: shown,
    };
  };

  // Lines of a logarithmic grid at powers of ten only, once there are several of them.
  const powers = (_, at) => {
    const tens = at.filter((v) => v !== 0 && Number.isInteger(Math.round(1e6 * Math.log10(Math.abs(v))) / 1e6));
    return tens.length < 3 ? at : at.map((v) => (v === 0 || tens.includes(v) ? v : null));
  };

  const axis = (label, size, log) => ({
    label, labelSize: 20, size, stroke: varda.colour("ink"), font: "12px system-ui, sans-serif",
    labelFont: "12px system-ui, sans-serif", grid: { stroke: varda.colour("line"), width: 1, ...(log ? { filter: powers } : {}) },
    ticks: { stroke: varda.colour("line"), width: 1, ...(log ? { filter: powers } : {}) },
    values: (_, at) => at.map((v) => (v === null ? "" : varda.short(v))),
  });

  const chart = (panel, width, title) => {
    const bands = [];
    const edges = panel.bands.flatMap((b, i) => {
      const first = 1 + panel.series.length + 2 * i;
      const colour = varda.ofStyle(b.style);
      bands.push({ series: [first + 1, first], fill: colour + "33" });
      const edge = (label) => ({ label, stroke: colour + "66", width: 1, spanGaps: true, points: { show: false },
        value: shown });
      return [edge(b.label + ", low"), edge(b.label + ", high")];
    });
    return {
      title: panel.title || undefined, width, height: 270, bands,
      cursor: { drag: { x: true, y: true, uni: 20 } },
      scales: { x: { time: false, distr: panel.log_x ? 3 : 1 }, y: { distr: panel.log_y ? 3 : panel.symlog_y ? 4 : 1 } },
      axes: [axis(panel.x_label, 50, panel.log_x), axis(panel.y_label, 70, panel.log_y || panel.symlog_y)],
      series: [{ label: panel.x_label, value: shown }, ...panel.series.map(ofSeries), ...edges],
      legend: { live: true, markers: { width: 2 } },
    };
  };

  // Numbers as colours, with axes and a scale beside them.
  const image = (panel, width) => {
    const { columns, values, x, y, downwards, range, label } = panel.image;
    const rows = values.length / columns;
    const [left, right, top, bottom] = [64, 100, panel.title ? 28 : 10, 44];
    const wide = Math.max(width - left - right, 60);
    const square = downwards && rows === columns;
    const high = square ? Math.min(wide, 320) : 240;
    const across = square ? high : wide;
    const dots = window.devicePixelRatio || 1;
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [dots * width, dots * (high + top + bottom)];
    canvas.style.width = "100%";
    const pen = canvas.getContext("2d");
    pen.scale(dots, dots);
    const cells = document.createElement("canvas");
    [cells.width, cells.height] = [columns, rows];
    const paint = cells.getContext("2d");
    const pixels = paint.createImageData(columns, rows);
    values.forEach((v, i) => {
      const row = Math.floor(i / columns);
      const at = 4 * ((downwards ? row : rows - 1 - row) * columns + (i % columns));
      const rgb = v === null ? [0, 0, 0] : varda.viridis((v - range[0]) / (range[1] - range[0] || 1));
      pixels.data.set([...rgb, v === null ? 0 : 255], at);
    });
    paint.putImageData(pixels, 0, 0);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(cells, left, top, across, high);
    pen.fillStyle = varda.colour("ink");
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "center";
    if (panel.title) pen.fillText(panel.title, left + across / 2, 18);
    const between = ([from, to], i) => {
      const digits = Math.min(Math.max(2 - Math.floor(Math.log10(Math.abs(to - from) || 1)), 0), 12);
      const v = from + (to - from) * i / 2;
      return varda.short(Number(v.toFixed(digits)));
    };
    for (let i = 0; i <= 2; i++) {
      pen.textAlign = "center";
      pen.fillText(between(x, i), left + across * i / 2, top + high + 16);
      pen.textAlign = "right";
      pen.fillText(between(y, i), left - 6, top + (downwards ? high * i / 2 : high * (1 - i / 2)) + 4);
      pen.textAlign = "left";
      pen.fillText(between(range, i), left + across + 30, top + high * (1 - i / 2) + 4);
    }
    pen.textAlign = "center";
    pen.fillText(panel.x_label, left + across / 2, top + high + 36);
    pen.save();
    pen.translate(14, top + high / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText(panel.y_label, 0, 0);
    pen.restore();
    pen.save();
    pen.translate(left + across + 92, top + high / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText(label, 0, 0);
    pen.restore();
    for (let i = 0; i < high; i++) {
      pen.fillStyle = `rgb(${varda.viridis(1 - i / high)})`;
      pen.fillRect(left + across + 12, top + i, 12, 1.5);
    }
    return canvas;
  };

  const drawFigure = (figure, element) => {
    element.replaceChildren();
    element.style.setProperty("--columns", figure.columns);
    element.setAttribute("role", "group");
    element.setAttribute("aria-label", figure.title);
    const boxes = figure.panels.map(() => document.createElement("div"));
    element.append(...boxes);
    figure.panels.forEach((panel, i) => {
      const box = boxes[i];
      const width = Math.max(Math.floor(box.clientWidth), 240);
      if (panel.image) {
        const canvas = image(panel, width);
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", `${panel.title || figure.title}: ${panel.image.label} from ` +
          `${varda.short(panel.image.range[0])} to ${varda.short(panel.image.range[1])}`);
        box.append(canvas);
        return;
      }
      const plot = new uPlot(chart(panel, width, figure.title), joined(panel), box);
      plot.over.setAttribute("role", "img");
      plot.over.setAttribute("aria-label", `${panel.y_label} against ${panel.x_label}: ` +
        panel.series.map((s) => s.label).filter((l) => l).join(", "));
      // The names of the legend hide and show their series, by keyboard too.
      box.querySelectorAll(".u-legend .u-series th").forEach((name) => {
        name.tabIndex = 0;
        name.addEventListener("keydown", (event) => {
          if (event.key === "Enter" || event.key === " ") { event.preventDefault(); name.click(); }
        });
      });
    });
    varda.drawn += 1;
  };

  varda.data.charts.forEach((figure, i) => {
    const element = document.getElementById("chart-" + i);
    let width = 0;
    const draw = () => { if (element.clientWidth > 0) drawFigure(figure, element); };
    // Drawn when it gets a width: at once, when it is chosen, and when the page becomes narrower or wider.
    new ResizeObserver(() => {
      if (element.clientWidth === width) return;
      width = element.clientWidth;
      requestAnimationFrame(draw);
    }).observe(element);
    varda.redraw.push(draw);
  });

  document.querySelectorAll(".one-of").forEach((figure) => {
    const select = figure.querySelector("select");
    const show = () => figure.querySelectorAll(".chart").forEach((chart) => {
      chart.parentElement.hidden = chart.id !== select.value;
    });
    select.addEventListener("change", show);
    show();
  });
}
