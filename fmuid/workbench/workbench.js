// Begins the page's session, and has pages drawn in the colours of the browser.
(function () {
  "use strict";
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
  Bokeh.embed.embed_items({}, [JSON.parse(item.textContent)]).then(() => {
    for (const doc of Bokeh.documents)
      doc.on_event("connection_lost", () => (document.getElementById("lost").hidden = false));
  });
})();
