// Draws the page's figures one after another and switches the joint they show. What a trace belongs to is in its meta.joint;
// a figure whose meta.together is set shows all joints at first, any other its meta.first.
(async () => {
  const canvases = [...document.querySelectorAll(".canvas")];
  const phone = matchMedia("(pointer: coarse)").matches;
  const shows = (figure, trace, joint) => {
    if (trace.meta?.joint === undefined) return true;
    if (joint !== "all") return trace.meta.joint === +joint;
    return figure.layout.meta?.together || trace.meta.joint === (figure.layout.meta?.first ?? 0);
  };
  const select = (canvas, joint) =>
    Plotly.restyle(canvas, { visible: canvas.data.map((trace) => shows(canvas, trace, joint)) });
  const chosen = () => document.querySelector(".joints input:checked")?.value ?? "all";

  for (const canvas of canvases) {
    const { data, layout } = JSON.parse(canvas.nextElementSibling.textContent);
    for (const trace of data) trace.visible = shows({ layout }, trace, chosen());
    if (phone) layout.dragmode = false; // a finger scrolls the page
    const entries = new Set(data.filter((trace) => trace.name && trace.showlegend !== false).map((trace) => trace.name)).size;
    if (canvas.clientWidth < 500 && entries > 4) {
      layout.height += 19 * entries; // its legend is a column
      canvas.style.height = `${layout.height}px`;
    }
    await Plotly.newPlot(canvas, data, layout, { responsive: true, displaylogo: false, displayModeBar: phone ? false : "hover" });
    await new Promise((next) => setTimeout(next)); // the page stays usable meanwhile
  }
  for (const input of document.querySelectorAll(".joints input"))
    input.addEventListener("change", () => canvases.forEach((canvas) => select(canvas, input.value)));
  if (canvases.length && chosen() !== "all") canvases.forEach((canvas) => select(canvas, chosen()));
  const width = (pixels) => canvases.forEach((canvas) => Plotly.relayout(canvas, { width: pixels, autosize: !pixels }));
  addEventListener("beforeprint", () => width(700));
  addEventListener("afterprint", () => width(null));
  document.documentElement.dataset.drawn = canvases.length;
})();
