"use strict";
(() => {
  const figures = JSON.parse(document.getElementById("figures-data").textContent);
  const drawn = new Map();
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const still = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["lasso2d", "select2d"] };
  let timeRange = null, printing = false;

  const colours = () => {
    const text = style("--text"), line = style("--line");
    const looks = { paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", "font.color": text };
    for (const axis of ["xaxis", "yaxis"]) {
      looks[`${axis}.gridcolor`] = line; looks[`${axis}.zerolinecolor`] = line; looks[`${axis}.linecolor`] = line;
    }
    return looks;
  };
  const isTime = (name) => figures[name].linked;

  function draw(name) {
    if (drawn.has(name)) return drawn.get(name);
    const element = document.getElementById(name), figure = figures[name];
    const layout = structuredClone(figure.layout);
    layout.paper_bgcolor = layout.plot_bgcolor = "rgba(0,0,0,0)";
    layout.font = { color: style("--text"), size: 13 };
    for (const axis of ["xaxis", "yaxis"]) {
      layout[axis] = { ...layout[axis], gridcolor: style("--line"), zerolinecolor: style("--line"), automargin: true };
    }
    if (element.clientWidth < 520) {  // a phone: the legend has no room above
      layout.legend = { orientation: "h", x: 0, y: -0.28, yanchor: "top" };
      layout.margin.b = 90;
    }
    if (isTime(name) && timeRange) { layout.xaxis.range = timeRange.slice(); layout.xaxis.autorange = false; }
    const done = Plotly.newPlot(element, figure.data, layout, still);
    drawn.set(name, done);
    if (isTime(name)) {
      done.then(() => element.on("plotly_relayout", (change) => follow(name, change)));
    }
    return done;
  }

  // Zooming one time plot zooms the others: those of the same log.
  function follow(name, change) {
    const reset = change["xaxis.autorange"] === true;
    const low = change["xaxis.range[0]"] ?? change["xaxis.range"]?.[0];
    const high = change["xaxis.range[1]"] ?? change["xaxis.range"]?.[1];
    if (!reset && (low === undefined || high === undefined)) return;
    timeRange = reset ? null : [low, high];
    for (const other of drawn.keys()) {
      if (other === name || !isTime(other)) continue;
      const axis = document.getElementById(other).layout.xaxis;
      if (reset) { if (!axis.autorange) Plotly.relayout(other, { "xaxis.autorange": true }); continue; }
      if (axis.range && axis.range[0] === low && axis.range[1] === high) continue;
      Plotly.relayout(other, { "xaxis.range": [low, high] });
    }
  }

  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (entry.isIntersecting) { seen.unobserve(entry.target); draw(entry.target.id); }
    }
  }, { rootMargin: "400px" });
  for (const name of Object.keys(figures)) seen.observe(document.getElementById(name));

  const repaint = () => { for (const name of drawn.keys()) Plotly.relayout(name, colours()); };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
  addEventListener("beforeprint", () => { printing = true; Object.keys(figures).forEach(draw); repaint(); });
  addEventListener("afterprint", () => { if (printing) { printing = false; repaint(); } });
  window.svmdistReport = { drawAll: () => Promise.all(Object.keys(figures).map(draw)) };
})();
