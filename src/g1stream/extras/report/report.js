"use strict";
// Draws the figures of the page. What they show is packed beside it: gzip in base64.
(async () => {
  const unpack = async (id) => {
    const text = document.getElementById(id).textContent;
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(plain).text();
  };
  const floats = (text) =>
    new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);

  const script = document.createElement("script");
  script.textContent = await unpack("plotly");
  document.head.append(script);
  const drawn = JSON.parse(await unpack("figures"));

  const DARK = "#1a1a1a", MUTED = "#5f6670", GRID = "#e9ecef", PINK = "#c2185b";
  const EVENTS = { event: MUTED, warning: "#d97706", error: "#b3261e" };
  const KINDS = { WARNING: "warning", ERROR: "error", FATAL: "error" }; // by level
  // A joint's panels from top to bottom, px; each has an axis and a legend of its own.
  const PANELS = { q: 260, error: 120, tau: 140 }, GAP = 36;
  const touch = matchMedia("(pointer: coarse)").matches;

  const axis = (title, more) => ({
    title: { text: title }, gridcolor: GRID, zeroline: false, automargin: true, ...more,
  });
  const jointAxis = () => axis("joint", {
    tickangle: -90, tickfont: { size: 10 }, dtick: 1, title: { text: "joint", standoff: 8 },
  });
  const layout = (height, more) => ({
    height, autosize: true, margin: { l: 56, r: 8, t: 28, b: 44 },
    font: { family: "system-ui, sans-serif", size: 12, color: DARK },
    paper_bgcolor: "#fff", plot_bgcolor: "#fff", hovermode: "closest",
    dragmode: touch ? false : "zoom", // a finger scrolls the page
    legend: { orientation: "h", x: 0, y: 1, yanchor: "bottom" }, ...more,
  });
  const phases = (session) => session.phases.map((one) => ({
    type: "rect", xref: "x", yref: "paper", x0: one.start, x1: one.end, y0: 0, y1: 1,
    layer: "below", line: { width: 0 }, fillcolor: one.colour ?? "rgba(0,0,0,0)",
  }));
  // Their names lie on the grid lines; upright where the phase is short.
  const names = (session) => session.phases.flatMap((one) => {
    const share = (one.end - one.start) / length(session);
    return share < 0.02 ? [] : [{
      text: one.name, x: (one.start + one.end) / 2, y: 1, yref: "paper", yanchor: "top",
      showarrow: false, font: { size: 10, color: MUTED }, bgcolor: one.colour ?? "#fff",
      textangle: share < 0.1 ? -90 : 0, borderpad: 1,
    }];
  });
  const length = (session) =>
    session.phases.length ? session.phases.at(-1).end - session.phases[0].start : 0;
  // With room for the markers at the ends.
  const times = (session, more) => axis(
    session.phases.length ? "time since the motion began, s" : "time, s", {
      ...(session.phases.length && { range: [session.phases[0].start - 0.015 * length(session),
                                             session.phases.at(-1).end + 0.015 * length(session)] }),
      ...more,
    });
  const line = (curve, more) => ({
    type: "scatter", mode: "lines", x: floats(curve.x), y: floats(curve.y), name: curve.name,
    line: { width: 1.5, color: curve.colour }, ...more,
  });
  // Errors are scaled to PLAY; those of RAMP may be larger.
  const scaled = (session, lines, least) => {
    const play = session.phases.find(({ name }) => name === "PLAY");
    const seen = play ? lines.flatMap(({ x, y }) => [...y].filter((value, i) =>
      x[i] >= play.start && x[i] <= play.end && !Number.isNaN(value))) : [];
    if (!seen.length) return {};
    const low = Math.min(...seen), high = Math.max(...seen), room = 0.1 * (high - low) || 1e-3;
    return { range: [least ?? low - room, high + room] };
  };
  const plain = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;")
    .replace(/(.{60,}?) /g, "$1<br>");

  const draw = {
    limbs(session) {
      const events = Object.entries(EVENTS).map(([name, color]) => {
        const shown = session.events.filter(({ level }) => (KINDS[level] ?? "event") === name);
        return {
          type: "scatter", mode: "markers", name,
          x: shown.map((event) => event.time), y: shown.map(() => 0),
          text: shown.map((event) => plain(`${event.level} ${event.text}`)),
          hovertemplate: "%{x:.2f} s<br>%{text}<extra></extra>", cliponaxis: false,
          marker: { symbol: "triangle-up", size: 10, color }, showlegend: shown.length > 0,
        };
      });
      const limbs = session.limbs.map((limb) => line(limb));
      return [[...limbs, ...events],
        layout(320, { shapes: phases(session), annotations: names(session), xaxis: times(session),
                      yaxis: axis("RMS error, deg", scaled(session, limbs, 0)) })];
    },
    joint(session, chosen) {
      const rows = Object.keys(PANELS).filter((one) => session.signals[one].lines.length);
      const inner = rows.reduce((sum, one) => sum + PANELS[one] + GAP, -GAP);
      const traces = [], panels = {}, bounds = [];
      let top = inner;
      for (const [i, quantity] of rows.entries()) {
        const { lines, label } = session.signals[quantity], n = i ? i + 1 : "";
        const curves = lines.map((one, k) => {
          const style = one.name === "simulated" ? { width: 1.2, color: PINK }
            : k < lines.length - 1 ? { width: 1, color: DARK, dash: "dash" }
            : { width: 1.5, color: session.colours[chosen] };
          return line({ ...one.joints[chosen], name: one.name },
            { yaxis: `y${n}`, legend: `legend${n}`, showlegend: true, line: style });
        });
        traces.push(...curves.reverse()); // what was asked for lies on top
        panels[`yaxis${n}`] = axis(label,
          { domain: [Math.max(0, top - PANELS[quantity]) / inner, top / inner],
            ...(quantity === "error" && scaled(session, curves)) });
        panels[`legend${n}`] = { orientation: "h", x: 0, y: top / inner, yanchor: "bottom" };
        top -= PANELS[quantity] + GAP;
        const limit = quantity === "tau" && session.torque_limits[chosen];
        if (limit) bounds.push(...[limit, -limit].map((y) => ({
          type: "line", xref: "paper", x0: 0, x1: 1, yref: `y${n}`, y0: y, y1: y,
          line: { width: 1, dash: "dot", color: EVENTS.error },
        })));
      }
      return [traces, layout(inner + 72, {
        shapes: [...phases(session), ...bounds], annotations: names(session),
        xaxis: times(session, { anchor: `y${rows.length > 1 ? rows.length : ""}` }), ...panels,
      })];
    },
    rmse_deg(session) {
      const bars = { type: "bar", x: session.joints, y: session.rmse_deg,
                     marker: { color: session.colours },
                     hovertemplate: "%{x}<br>%{y:.3f} deg<extra></extra>" };
      return [[bars], layout(340, {
        xaxis: jointAxis(), yaxis: axis("RMSE, deg") })];
    },
    lateness(session) {
      const bars = { type: "bar", x: session.lateness.map((bin) => bin.us),
                     y: session.lateness.map((bin) => bin.ticks),
                     marker: { color: "#0072b2" },
                     hovertemplate: "%{x} µs<br>%{y} ticks<extra></extra>" };
      return [[bars], layout(300, {
        xaxis: axis("lateness of the write against its deadline, µs", { type: "category" }),
        yaxis: axis("ticks", { type: "log", dtick: 1 }) })];
    },
    intervals(session) {
      return [session.intervals.map((one) => line(one)), layout(280, {
        shapes: phases(session), annotations: names(session), xaxis: times(session),
        yaxis: axis("interval, ms", { rangemode: "tozero" }) })];
    },
    steps(session) {
      return [session.steps.map((one) => line(one)), layout(280, {
        shapes: phases(session), annotations: names(session), xaxis: times(session),
        yaxis: axis("delay, ms", { rangemode: "tozero" }) })];
    },
  };

  const config = {
    responsive: true, displaylogo: false, displayModeBar: touch ? false : "hover",
    modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
  };
  const plots = [...document.querySelectorAll("[data-figure]")];
  for (const plot of plots) {
    const data = drawn[plot.dataset.drawn], figure = draw[plot.dataset.figure];
    const select = plot.closest("figure").querySelector("select");
    await Plotly.newPlot(plot, ...figure(data, Number(select?.value)), config);
    if (select) {
      select.addEventListener("change", () =>
        Plotly.react(plot, ...figure(data, Number(select.value)), config));
    }
    if (plot.dataset.figure.includes("rmse")) {
      plot.on("plotly_click", ({ points }) => {
        const joints = plot.closest("section").querySelector("select");
        joints.value = points[0].pointIndex;
        joints.dispatchEvent(new Event("change"));
        joints.scrollIntoView({ behavior: "smooth" });
      });
    }
  }

  const closed = () => document.querySelectorAll("details:not([open])");
  addEventListener("beforeprint", () => {
    for (const one of closed()) one.open = true;
    const width = 700; // A4 without its margins
    // The first time leaves the legends where they were in the other width, on the lines.
    for (const plot of [...plots, ...plots]) Plotly.relayout(plot, { width });
  });
  addEventListener("afterprint", () => {
    for (const plot of plots) Plotly.relayout(plot, { width: null, autosize: true });
  });
  document.documentElement.dataset.drawn = plots.length;
})().catch((error) => {
  for (const plot of document.querySelectorAll("[data-figure]"))
    plot.textContent = "This browser cannot draw the figures: it has to be one of 2023 or later.";
  throw error;
});
