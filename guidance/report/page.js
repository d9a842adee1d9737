"use strict";
(() => {
  const charts = JSON.parse(document.getElementById("charts").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const colours = () => dark.matches
    ? { ink: "#e4e8ec", grid: "#2c343d", line: "#66717d", paper: "#15191e" }
    : { ink: "#1b1f23", grid: "#e6eaee", line: "#8c959f", paper: "#ffffff" };
  const painted = (layout) => {
    const c = colours();
    const axis = (a) => ({ ...a, gridcolor: c.grid, linecolor: c.line, tickcolor: c.line, showline: true });
    const made = { ...layout, font: { ...layout.font, color: c.ink } };
    made.hoverlabel = { bgcolor: c.paper, bordercolor: c.line, font: { color: c.ink }, align: "left", namelength: -1 };
    for (const key of Object.keys(layout)) {
      if (/^[xy]axis\d*$/.test(key)) made[key] = axis(layout[key]);
    }
    if (layout.scene) {
      made.scene = { ...layout.scene };
      for (const key of ["xaxis", "yaxis", "zaxis"]) {
        made.scene[key] = { ...axis(layout.scene[key]), showbackground: false };
      }
    }
    return made;
  };
  // What was flown is nobody else's business: plotly.js would offer to upload it.
  const options = {
    responsive: true, displaylogo: false, showSendToCloud: false, plotlyServerURL: "",
    modeBarButtonsToRemove: ["select2d", "lasso2d", "zoomIn2d", "zoomOut2d", "autoScale2d", "tableRotation",
      "resetCameraLastSave3d"],
  };
  const draw = () => {
    for (const [name, chart] of Object.entries(charts)) {
      Plotly.react(document.getElementById(name), chart.data, painted(chart.layout), options);
    }
  };
  draw();
  dark.addEventListener("change", draw);
})();
