"use strict";
(() => {
  const specs = JSON.parse(document.getElementById("data").textContent);
  const root = document.documentElement;
  const colour = (name) => getComputedStyle(root).getPropertyValue("--" + name).trim();
  const HEIGHT = 220;
  const drawn = [];

  // A value to four digits.
  const shown = (value) => {
    if (value == null || !Number.isFinite(value)) return "";
    const size = Math.abs(value);
    if (size !== 0 && size < 1e-3) return value.toExponential(1);
    return value.toFixed(size >= 1000 ? 0 : size >= 100 ? 1 : size >= 10 ? 2 : size >= 1 ? 3 : 4);
  };

  // What is drawn next stays inside the axes, also where they are zoomed.
  const clip = ({ ctx, bbox }) => {
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
  };

  // The marked place with its interval, under the series.
  const drawMark = (plot, mark, isPeak) => {
    const { ctx, bbox } = plot;
    const place = (value) => plot.valToPos(value, "x", true);
    const ratio = devicePixelRatio || 1;
    ctx.save();
    clip(plot);
    if (mark.interval) {
      const [low, high] = mark.interval.map(place);
      ctx.fillStyle = colour("before");
      ctx.globalAlpha = 0.18;
      ctx.fillRect(low, bbox.top, Math.max(high - low, 1), bbox.height);
      ctx.globalAlpha = 1;
    }
    const at = place(mark.at);
    ctx.strokeStyle = ctx.fillStyle = colour("before");
    ctx.lineWidth = ratio;
    ctx.beginPath();
    ctx.moveTo(at, bbox.top);
    ctx.lineTo(at, bbox.top + bbox.height);
    ctx.stroke();
    ctx.font = `600 ${12 * ratio}px system-ui, sans-serif`;
    const isRight = at > bbox.left + bbox.width * 0.6;
    ctx.textAlign = isRight ? "right" : "left";
    // Beside the foot of a peak, and above the foot of a valley.
    const above = isPeak ? bbox.height - 8 * ratio : 14 * ratio;
    ctx.fillText(mark.label, at + (isRight ? -6 : 6) * ratio, bbox.top + above);
    ctx.restore();
  };

  // The limits, across the plot; one that is far off is said and not drawn.
  const drawLimits = (plot, spec) => {
    const { ctx, bbox } = plot;
    const ratio = devicePixelRatio || 1;
    ctx.save();
    clip(plot);
    ctx.strokeStyle = ctx.fillStyle = colour("limit");
    ctx.lineWidth = 1.25 * ratio;
    ctx.font = `600 ${11 * ratio}px system-ui, sans-serif`;
    // Readable over what is drawn.
    const say = (text, x, y) => {
      ctx.save();
      ctx.setLineDash([]);
      ctx.strokeStyle = colour("paper");
      ctx.lineWidth = 4 * ratio;
      ctx.lineJoin = "round";
      ctx.strokeText(text, x, y);
      ctx.fillText(text, x, y);
      ctx.restore();
    };
    spec.limits.forEach(({ at, along, label }) => {
      const place = plot.valToPos(at, along ? "x" : "y", true);
      const top = bbox.top, left = bbox.left, right = left + bbox.width;
      const isOut = along ? place < left || place > right : place < top || place > top + bbox.height;
      if (isOut) {
        if (label && !along && place < top) {
          ctx.textAlign = "right";
          say(`${label} ↑`, right - 4 * ratio, top + 12 * ratio);
        }
        return;
      }
      ctx.setLineDash([6 * ratio, 4 * ratio]);
      ctx.beginPath();
      ctx.moveTo(along ? place : left, along ? top : place);
      ctx.lineTo(along ? place : right, along ? top + bbox.height : place);
      ctx.stroke();
      ctx.setLineDash([]);
      if (!label) return;
      ctx.textAlign = along ? "left" : "right";
      const isHigh = !along && place < top + 16 * ratio;
      if (along) say(label, place + 4 * ratio, top + bbox.height - 22 * ratio);
      else say(label, right - 4 * ratio, place + (isHigh ? 12 : -4) * ratio);
    });
    ctx.restore();
  };

  // The interval of each value.
  const drawIntervals = (plot, spec) => {
    const { ctx } = plot;
    spec.series.forEach((series) => {
      if (!series.half) return;
      ctx.save();
      clip(plot);
      ctx.strokeStyle = colour(series.role);
      ctx.lineWidth = devicePixelRatio || 1;
      series.values.forEach((value, row) => {
        if (value == null) return;
        const x = plot.valToPos(spec.x[row], "x", true);
        ctx.beginPath();
        ctx.moveTo(x, plot.valToPos(value - series.half[row], "y", true));
        ctx.lineTo(x, plot.valToPos(value + series.half[row], "y", true));
        ctx.stroke();
      });
      ctx.restore();
    });
  };

  const options = (spec, width) => {
    const axis = {
      stroke: () => colour("quiet"),
      grid: { stroke: () => colour("grid"), width: 1 },
      ticks: { stroke: () => colour("grid"), width: 1, size: 4 },
      font: "12px system-ui, sans-serif",
    };
    const halves = spec.series.flatMap((series) => (series.half || []).filter((h) => h != null));
    const reach = halves.length ? Math.max(...halves) : 0;
    const range = (_, low, high) => {
      if (low == null) return [0, 1];
      // A limit that is not far off is shown.
      const size = Math.max(Math.abs(low), Math.abs(high));
      spec.limits.forEach(({ at, along }) => {
        if (along || (!spec.shows_limits && Math.abs(at) > 4 * size)) return;
        high = Math.max(high, at);
        low = Math.min(low, at);
      });
      if (spec.zero) return [0, high > 0 ? high * 1.05 : 1];
      const room = (high - low) * 0.08 + Math.min(reach, 4 * (high - low)) || 1;
      return [low - room, high + room];
    };
    return {
      width,
      height: HEIGHT,
      padding: [8, 10, 0, 0],
      scales: { x: { time: false }, y: { range } },
      cursor: { points: { size: 7 }, drag: { x: true, y: false } },
      legend: { markers: { fill: (plot, at) => (at ? colour(spec.series[at - 1].role) : "none"), width: 0 } },
      axes: [
        { ...axis, label: spec.x_label, labelSize: 18, labelFont: axis.font, size: 28, gap: 3 },
        { ...axis, size: 46, gap: 3, values: (_, splits) => splits.map((at) => (at == null ? "" : `${+at.toPrecision(6)}`)) },
      ],
      series: [
        { label: spec.x_label, value: (_, value) => shown(value) },
        ...spec.series.map(({ label, role, points }) => ({
          label,
          stroke: () => colour(role),
          width: role === "before" ? 1 : 1.75,
          dash: role === "beside" ? [5, 4] : role === "limit" ? [2, 3] : undefined,
          paths: points ? () => null : undefined,
          points: {
            // Where there is room, uPlot shows those of lines by itself.
            show: points || (role === "beside" ? false : undefined),
            size: spec.x.length > 200 ? 2.5 : 6,
            fill: () => colour(role),
            width: 0,
          },
          value: (_, value) => shown(value),
        })),
      ],
      hooks: {
        drawAxes: [(plot) => spec.mark && drawMark(plot, spec.mark, !spec.zero)],
        draw: [(plot) => drawIntervals(plot, spec), (plot) => drawLimits(plot, spec)],
      },
    };
  };

  // Arrow keys walk along the axis and have the values read out.
  const keys = (event, plot, spec, readout) => {
    const last = spec.x.length - 1;
    const step = Math.max(1, Math.round(last / (event.shiftKey ? 10 : 60)));
    const row = plot.row ?? -step;
    const rows = { ArrowRight: row + step, ArrowLeft: row - step, Home: 0, End: last };
    if (event.key === "Escape") {
      plot.setCursor({ left: -10, top: -10 });
      readout.textContent = "";
      return;
    }
    if (!(event.key in rows)) return;
    event.preventDefault();
    plot.row = Math.min(Math.max(rows[event.key], 0), last);
    plot.setCursor({ left: plot.valToPos(spec.x[plot.row], "x"), top: HEIGHT / 3 });
    const values = spec.series.map(({ label, values }) => `${label} ${shown(values[plot.row])} ${spec.y_label}`);
    readout.textContent = `${spec.x_label} ${shown(spec.x[plot.row])}: ${values.join(", ")}`;
  };

  const draw = (element, width) => {
    const spec = specs[element.dataset.plot];
    const readout = element.parentElement.querySelector(".readout");
    element.replaceChildren();
    const data = [spec.x, ...spec.series.map((series) => series.values)];
    const plot = new uPlot(options(spec, width || element.clientWidth), data, element);
    element.onkeydown = (event) => keys(event, plot, spec, readout);
    element.onblur = () => { readout.textContent = ""; };
    return plot;
  };

  const plots = document.querySelectorAll(".plot");
  const all = (width) => plots.forEach((element, at) => {
    if (drawn[at]) drawn[at].destroy();
    drawn[at] = draw(element, width);
  });
  all();
  let width = root.clientWidth;
  addEventListener("resize", () => {
    if (root.clientWidth === width) return;
    width = root.clientWidth;
    drawn.forEach((plot, at) => plot.setSize({ width: plots[at].clientWidth, height: HEIGHT }));
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => all());
  // On paper: dark on light, and no wider than half a page or a narrow one.
  addEventListener("beforeprint", () => { root.classList.add("print"); all(330); });
  addEventListener("afterprint", () => { root.classList.remove("print"); all(); });
})();
