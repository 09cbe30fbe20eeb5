// Unpacks the library and the figures, and draws one section after the other, so that the first is there at once. Figures
// have light colours; each is exchanged for its twin where the page is dark.
(async function () {
  "use strict";
  if (typeof DecompressionStream === "undefined") {
    const said = "The figures are not drawn: they need a browser of 2023 or later.";
    for (const each of document.querySelectorAll(".cells")) each.textContent = said;
    return;
  }
  const query = window.matchMedia("(prefers-color-scheme: dark)");
  const LIGHT = Object.fromEntries(Object.entries(DARK).map(([light, dark]) => [dark, light]));
  const PAPER = 690; // pixels between the margins of A4 and Letter
  let shown = query.matches;

  function unpacked(name) {
    const packed = Uint8Array.from(atob(document.getElementById(name).text), (each) => each.charCodeAt(0));
    return new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  }

  function exchanged(value, map) {
    if (typeof value === "string") return map[value];
    if (value !== null && typeof value === "object" && typeof value.value === "string" && value.value in map)
      return { ...value, value: map[value.value] };
    return undefined;
  }

  function paint(dark) {
    if (dark === shown) return;
    const map = dark ? DARK : LIGHT;
    for (const doc of Bokeh.documents)
      for (const model of doc.all_models)
        for (const property of model) {
          if (!/color$/.test(property.attr)) continue;
          const value = exchanged(property.get_value(), map);
          if (value !== undefined) model.setv({ [property.attr]: value });
        }
    shown = dark;
  }

  const plots = (view) => [view.model.type === "Plot" ? [view] : [], ...[...(view.children?.() ?? [])].map(plots)].flat();

  // Paper is white, and is laid out before a figure could follow: figures are painted at once, in the width they have.
  function print() {
    const width = document.querySelector("main").offsetWidth;
    document.documentElement.style.setProperty("--printed", `${width}px`);
    document.documentElement.style.setProperty("--zoom", Math.min(1, PAPER / width));
    if (!shown) return;
    paint(false);
    for (const view of [...(Bokeh.index.roots ?? Object.values(Bokeh.index))].flatMap(plots)) {
      view.invalidate_painters();
      view.repaint();
    }
  }

  const program = document.createElement("script");
  program.text = await unpacked("library");
  document.body.append(program);
  const map = shown ? DARK : {};
  const colored = (name, value) => (/color$/.test(name) && exchanged(value, map)) || value;
  for (const [content, places] of JSON.parse(await unpacked("figures"), colored)) {
    await Bokeh.embed.embed_items(content, places);
    await new Promise((done) => setTimeout(done)); // what the reader does comes first
  }
  query.addEventListener("change", () => paint(query.matches));
  window.addEventListener("beforeprint", print);
  window.addEventListener("afterprint", () => paint(query.matches));
  paint(query.matches); // it may have changed meanwhile
  document.documentElement.dataset.drawn = "all";
})();
