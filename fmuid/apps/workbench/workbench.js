// Begins the page's session, and has pages drawn in the colors of the browser.
(function () {
  "use strict";
  const AGAIN = 1000; // ms
  const query = window.matchMedia("(prefers-color-scheme: dark)");
  const secure = location.protocol === "https:" ? "; Secure" : "";

  function follow() {
    const wanted = query.matches ? "dark" : "light";
    if (document.documentElement.dataset.scheme === wanted) return true;
    document.cookie = `fmuid-scheme=${wanted}; Path=/; SameSite=Strict${secure}`;
    if (!document.cookie.includes(`fmuid-scheme=${wanted}`)) return true;
    location.reload();
    return false;
  }

  query.addEventListener("change", follow);
  if (!follow()) return;
  const item = document.getElementById("item");
  if (item === null || typeof Bokeh === "undefined") return;
  Bokeh.set_log_level("warn");
  // Bokeh lets what lies on its overlay, as lines that follow a slider, run over the axes.
  const line = Bokeh.Models.get("GlyphRenderer").prototype.default_view.prototype;
  Object.defineProperty(line, "needs_clip", { value: true });
  const lost = document.getElementById("lost");
  Bokeh.embed.embed_items({}, [JSON.parse(item.textContent)]).then(drawn, () => say("This page could not start. Reload it."));

  function say(words) {
    lost.textContent = words;
    lost.hidden = false;
  }

  // The connection was cut, or the workbench has ended, which cannot be told apart: asked again until one answers. Then
  // the page is loaded anew, with what its sliders show.
  function cut(doc) {
    say(
      "The workbench does not answer. This page reloads as soon as it does. If fmuid workbench has ended, start it again and " +
        "open the address that it prints. Its commands continue, or have saved their results."
    );
    setTimeout(async function ask() {
      const answer = await fetch("/own/workbench.js").catch(() => null);
      if (answer === null) setTimeout(ask, AGAIN);
      else if (answer.ok) location.replace(doc.get_model_by_name("command")?.tags[0] ?? location.href);
      else say("The workbench was restarted. Open the address that it has printed.");
    }, AGAIN);
  }

  // A name for what has none to be read out: sliders, typed values, switches that are all labelled alike. A table is
  // passed over by the keyboard, which would stop at each of its cells: its cases are chosen by their number.
  function name(view) {
    const place = view.shadow_el?.querySelector(".noUi-handle,input,button");
    const told = [...(place?.labels ?? [])].some((label) => label.textContent) || place?.tagName === "BUTTON";
    if (place && view.model.name && (!told || view.model.type === "Toggle")) place.setAttribute("aria-label", view.model.name);
    if (view.model.type === "DataTable")
      for (const stop of view.shadow_el.querySelectorAll("[tabindex],[hidefocus]")) stop.tabIndex = -1;
    if (view.model.type === "Tabs") view.shadow_el.addEventListener("keydown", pressed);
    for (const child of view.children?.() ?? []) name(child);
  }

  function pressed(event) {
    if (!event.target.matches(".bk-tab") || !["Enter", " "].includes(event.key)) return;
    event.preventDefault();
    event.target.click();
  }

  // What the server follows is there; then come the figures that are as they are.
  async function drawn() {
    for (const doc of Bokeh.documents) doc.on_event("connection_lost", cut);
    for (const view of Bokeh.index.roots ?? Object.values(Bokeh.index)) name(view);
    const still = document.getElementById("figures");
    if (still !== null) await draw(still);
    document.documentElement.dataset.drawn = "all";
  }

  // One section after the other.
  async function draw(still) {
    const { colors } = JSON.parse(still.textContent);
    const twin = (value) => (value?.value in colors ? { ...value, value: colors[value.value] } : colors[value]);
    const colored = (name, value) => (/color$/.test(name) && twin(value)) || value;
    for (const [content, places] of JSON.parse(still.textContent, colored).drawings) {
      await Bokeh.embed.embed_items(content, places);
      await new Promise((done) => setTimeout(done)); // what the reader does comes first
    }
  }
})();
