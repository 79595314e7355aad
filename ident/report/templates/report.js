"use strict";
(function () {
  const page = JSON.parse(document.getElementById("figures").textContent);
  const touch = window.matchMedia("(pointer: coarse)").matches;
  const config = {
    displaylogo: false,
    responsive: true,
    scrollZoom: false,
    displayModeBar: touch ? false : "hover",
    modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
  };
  // figures have the colours of the reader's theme; printed pages are light
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  let night = dark.matches;
  function coloured(value) {
    let text = JSON.stringify(value);
    if (night) for (const [light, other] of Object.entries(page.dark)) text = text.split(light).join(other);
    return unpacked(JSON.parse(text));
  }
  // {q, low, high}: whole numbers of 16 bits in base64, 0 is low, 65534 is high, 65535 a gap (drawing.py)
  function unpacked(value) {
    if (Array.isArray(value)) return value.map(unpacked);
    if (value === null || typeof value !== "object") return value;
    if (value.q === undefined) {
      return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, unpacked(item)]));
    }
    const bytes = atob(value.q);
    const numbers = new Float64Array(bytes.length / 2);
    const step = (value.high - value.low) / 65534;
    for (let i = 0; i < numbers.length; i++) {
      const level = bytes.charCodeAt(2 * i) + 256 * bytes.charCodeAt(2 * i + 1);
      numbers[i] = level === 65535 ? NaN : value.low + step * level;
    }
    return numbers;
  }
  const places = Array.from(document.querySelectorAll(".plot")).filter((place) => page.figures[place.id]);

  // The title of a panel is one line, which a narrow screen would cut off. A character is about half as wide as high.
  function narrowed(layout, width) {
    const room = width - (layout.margin?.l ?? 50) - (layout.margin?.r ?? 8);
    (layout.annotations ?? []).filter((note) => note.xref === "paper" && !note.showarrow).forEach((note) => {
      const size = Math.min(note.font.size, room / (0.53 * note.text.length));
      note.font = { ...note.font, size: Math.max(size, 7) };
    });
  }

  function draw(place) {
    if (place.dataset.drawn) return;
    place.dataset.drawn = "yes";
    const figure = coloured({ template: page.template, ...page.figures[place.id] });
    const layout = Object.assign({ template: figure.template }, figure.layout);
    // a finger must be able to scroll the page across a figure
    if (touch) layout.dragmode = false;
    narrowed(layout, place.clientWidth);
    Plotly.react(place, figure.data, layout, config);
  }
  function theme(isNight) {
    if (night === isNight) return;
    night = isNight;
    places.filter((place) => place.dataset.drawn).forEach((place) => {
      delete place.dataset.drawn;
      if (place.offsetParent) draw(place);
      else watcher.observe(place);
    });
  }
  dark.addEventListener("change", () => theme(dark.matches));

  // Figures are drawn shortly before they come into view, and all others of open tabs soon after the page has loaded:
  // headless browsers, which take pictures of a page, may report no figure as visible. Those in hidden tabs are drawn
  // when their tab opens.
  const watcher = new IntersectionObserver(
    (entries) => entries.filter((entry) => entry.isIntersecting).forEach((entry) => {
      watcher.unobserve(entry.target);
      draw(entry.target);
    }),
    { rootMargin: "600px" },
  );
  places.forEach((place) => watcher.observe(place));
  // one figure at a time, so that the page stays responsive
  function drawRest() {
    const place = places.find((each) => !each.dataset.drawn && each.offsetParent);
    if (!place) return;
    watcher.unobserve(place);
    draw(place);
    setTimeout(drawRest);
  }
  window.addEventListener("load", () => setTimeout(drawRest, 100));

  function choose(tab) {
    for (const other of tab.parentElement.children) {
      const chosen = other === tab;
      other.setAttribute("aria-selected", String(chosen));
      other.tabIndex = chosen ? 0 : -1;
      const panel = document.getElementById(other.getAttribute("aria-controls"));
      panel.classList.toggle("away", !chosen);
      if (!chosen) continue;
      places.filter((place) => panel.contains(place)).forEach(draw);
      resize(panel);
    }
  }
  // at once: Plotly.Plots.resize waits a tenth of a second, and by then the page is printed
  function resize(root) {
    root.querySelectorAll(".plot[data-drawn]").forEach((place) => {
      if (!place.offsetParent) return;
      delete place.layout.width;
      delete place.layout.height;
      Plotly.relayout(place, { autosize: true });
    });
  }
  document.querySelectorAll("[role=tablist]").forEach((list) => {
    list.addEventListener("click", (event) => {
      const tab = event.target.closest("[role=tab]");
      if (tab) choose(tab);
    });
    list.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      const tabs = Array.from(list.children);
      if (!step) return;
      const next = tabs[(tabs.indexOf(event.target) + step + tabs.length) % tabs.length];
      choose(next);
      next.focus();
    });
  });

  window.addEventListener("beforeprint", () => {
    const hidden = Array.from(document.querySelectorAll(".all-printed > .away"));
    hidden.forEach((panel) => panel.classList.remove("away"));
    document.body.classList.add("printing");
    theme(false);
    places.filter((place) => place.offsetParent).forEach(draw);
    resize(document);
    window.addEventListener("afterprint", () => {
      hidden.forEach((panel) => panel.classList.add("away"));
      document.body.classList.remove("printing");
      theme(dark.matches);
      resize(document);
    }, { once: true });
  });

  const links = new Map(Array.from(document.querySelectorAll(".contents a")).map((a) => [a.hash.slice(1), a]));
  const reader = new IntersectionObserver(
    (entries) => entries.filter((entry) => entry.isIntersecting).forEach((entry) => {
      links.forEach((link, id) => link.classList.toggle("here", id === (entry.target.id || "top")));
    }),
    { rootMargin: "-15% 0px -75% 0px" },
  );
  document.querySelectorAll("main > header, main > section").forEach((part) => reader.observe(part));
})();
