// Unpacks what draws the figures. They are drawn in light colours; each is exchanged for its twin where the page is dark.
(async function () {
  "use strict";
  if (typeof DecompressionStream === "undefined") {
    const said = "The figures are not drawn: they need a browser of 2023 or later.";
    for (const each of document.querySelectorAll(".cells")) each.textContent = said;
    return;
  }
  const packed = Uint8Array.from(atob(document.getElementById("packed").text), (each) => each.charCodeAt(0));
  const program = document.createElement("script");
  program.text = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  document.body.append(program);

  const query = window.matchMedia("(prefers-color-scheme: dark)");
  const LIGHT = Object.fromEntries(Object.entries(DARK).map(([light, dark]) => [dark, light]));
  let shown = false;

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

  function begin() {
    const waiting = Bokeh.documents.length === 0 || !Bokeh.documents.every((doc) => doc.is_idle);
    if (waiting && Bokeh.documents.length === 0) return void setTimeout(begin, 30);
    paint(query.matches);
  }

  query.addEventListener("change", () => paint(query.matches));
  window.addEventListener("beforeprint", () => paint(false));
  window.addEventListener("afterprint", () => paint(query.matches));
  begin();
})();
