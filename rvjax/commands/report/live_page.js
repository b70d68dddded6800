/* What a person touches and sees: built here, so that a page without scripts shows none of it. */

function startLive(section, data) {
  const BINS = 56, WIDE = 520, HIGH = 150;
  const $ = (name) => section.querySelector(`[data-live="${name}"]`);
  const read = (value) => String(Number(value.toPrecision(4)));
  const shown = (value, unit) => `${read(value)}${unit === "-" ? "" : ` ${unit.replace(/^u(?=m)/, "µ")}`}`;
  const percent = (share) => `${(100 * share).toFixed(share > 0.9 ? 3 : 2)} %`;
  const element = (tag, attributes = {}, ...children) => {
    const made = document.createElement(tag);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  };
  const controls = [], restored = [];
  let at = Live.begin(data, "centre"), waiting = false, speaking = 0;
  const start = Live.all(data, at);

  /* A slider with a field for the exact number; one is the label's, the other names itself. */
  function control(parent, label, unit, low, high, get, set, far) {
    const id = `live-${controls.length}`, step = 10 ** Math.floor(Math.log10((high - low) / 100));
    const range = element("input", { type: "range", id, min: low, max: high, step });
    const exact = element("input", { type: "number", step: "any", "aria-label": `${label}, exact, ${unit}` });
    const value = element("output", { for: id });
    const mark = element("span", { class: "far" });
    const row = element("div", { class: "live-row" }, element("label", { for: id }, label), value, range, exact, mark);
    let refused = "";
    parent.append(row);
    range.addEventListener("input", () => { refused = ""; set(Number(range.value)); follow(); });
    exact.addEventListener("change", () => {
      const { value: wanted, said } = Live.taken(exact.valueAsNumber, low, high, (number) => shown(number, unit));
      refused = said;
      if (wanted !== null) set(wanted);
      if (said) exact.value = read(get()); // the field has the focus, and is not written again
      follow();
    });
    restored.push(() => { refused = ""; });
    controls.push(() => {
      const now = get();
      range.value = now;
      range.setAttribute("aria-valuetext", shown(now, unit));
      if (document.activeElement !== exact) exact.value = read(now);
      value.textContent = shown(now, unit);
      mark.textContent = [refused, far() ? "outside the region" : ""].filter(Boolean).join("; ");
    });
  }

  const parameter = (k, label) => {
    const p = data.parameters[k];
    control($(p.place ? "middles" : "half-widths"), label, p.unit, p.low, p.high, () => at.parameters[k],
      (value) => { at.parameters[k] = value; }, () => Math.abs(at.parameters[k] - p.centre) > p.reach * (1 + 1e-9));
  };
  for (const field of data.fields) parameter(field.half, `${field.label} ${field.sign}`);
  for (const field of data.fields)
    if (field.place !== null) parameter(field.place, `${field.label}, ${field.grows ? "lower limit" : "middle"}`);
  data.responses.forEach((response, k) => {
    for (const end of ["lower", "upper"]) {
      if (response.own[end] === null) continue;
      const [low, high] = response.range[end];
      control($("limits"), `${response.label} ${end === "lower" ? "≥" : "≤"}`, response.unit, low, high,
        () => at.limits[k][end], (value) => { at.limits[k] = { ...at.limits[k], [end]: value }; }, () => false);
    }
  });

  const judged = data.responses.map((response) => {
    const cells = ["value", "required", "mean", "sd", "Cpk", "verdict"].map((name) =>
      element("td", { "data-label": name }));
    $("figures").append(element("tr", {}, element("th", { scope: "row" }, response.label), ...cells));
    const picture = element("figure", { class: "live-figure" });
    picture.innerHTML = `<svg viewBox="0 0 ${WIDE} ${HIGH + 18}" role="img"><path class="bars"/><path class="was"/>
      <g class="limits"></g><path class="axis" d="M0 ${HIGH}H${WIDE}"/><text class="left" y="${HIGH + 14}"></text>
      <text class="right" y="${HIGH + 14}" x="${WIDE}" text-anchor="end"></text></svg>`;
    const bars = element("ul", { class: "live-shares" });
    picture.append(element("figcaption", {}, `${response.label}: units now (filled), as allocated (line), limits; ` +
      "below, shares of the variance"), bars);
    $("pictures").append(picture);
    return { cells, svg: picture.querySelector("svg"), bars };
  });

  /* Span of a histogram: the units now and as allocated, and the limits. */
  function span(k, y) {
    const ends = [y, start.y[k]].flatMap(Live.ends);
    if (data.responses[k].limits_values) ends.push(...Object.values(at.limits[k]).filter((limit) => limit !== null));
    const low = Math.min(...ends), high = Math.max(...ends), room = 0.04 * (high - low || 1);
    const floor = data.responses[k].floor;
    return [floor === null ? low - room : Math.max(floor, low - room), high + room];
  }

  function drawn(k, found) {
    const { svg, bars } = judged[k], response = data.responses[k];
    const possible = (list) => (response.floor === null ? list : list.map((value) => Math.max(response.floor, value)));
    const y = possible(found.y[k]), ends = span(k, y);
    const [now, was] = [y, possible(start.y[k])].map((list) => Live.counted(list, data.weights, ends, BINS));
    const top = Math.max(...now, ...was);
    const steps = (bins, close) => {
      let path = close ? `M0 ${HIGH}` : "M0 " + (HIGH * (1 - bins[0] / top)).toFixed(1);
      bins.forEach((share, i) => {
        path += `V${(HIGH * (1 - share / top)).toFixed(1)}H${(((i + 1) * WIDE) / BINS).toFixed(1)}`;
      });
      return close ? path + `V${HIGH}Z` : path;
    };
    svg.querySelector(".bars").setAttribute("d", steps(now, true));
    svg.querySelector(".was").setAttribute("d", steps(was, false));
    const limits = response.limits_values ? Object.values(at.limits[k]).filter((limit) => limit !== null) : [];
    svg.querySelector(".limits").innerHTML = limits.map((limit) => {
      const x = (((limit - ends[0]) / (ends[1] - ends[0])) * WIDE).toFixed(1);
      return `<path d="M${x} 0V${HIGH}"/>`;
    }).join("");
    svg.querySelector(".left").textContent = shown(ends[0], response.unit);
    svg.querySelector(".right").textContent = shown(ends[1], response.unit);
    const figure = found.figures[k];
    svg.setAttribute("aria-label",
      `${response.label}: mean ${shown(figure.mean, response.unit)}, standard deviation ${shown(figure.sd, response.unit)}`);
    const parts = found.shares[k].map((share, i) => [share, data.fields[i].label]).filter(([share]) => share >= 0.005)
      .sort((a, b) => b[0] - a[0]);
    bars.replaceChildren(...parts.map(([share, label]) => {
      const bar = element("span", { class: "bar" });
      bar.style.width = `${(100 * share).toFixed(1)}%`;
      return element("li", {}, element("span", {}, label), element("span", {}, `${(100 * share).toFixed(1)} %`), bar);
    }));
  }

  function told(found) {
    const signs = { true: "✔ met", false: "✘ not met", undefined: "not followed here" };
    data.responses.forEach((response, k) => {
      const figure = found.figures[k], { cells } = judged[k], unit = response.unit;
      const main = { share: percent(figure.yield), cpk: read(figure.cpk), mean: shown(figure.mean, unit),
        sd: shown(figure.sd, unit), worst: "-" }[response.kind];
      const texts = [main, response.required, shown(figure.mean, unit), shown(figure.sd, unit),
        response.of_units ? read(figure.cpk) : "-", signs[figure.met]];
      cells.forEach((cell, i) => { cell.textContent = texts[i]; });
      cells[5].className = figure.met === false ? "missed-mark" : figure.met ? "met" : "";
      drawn(k, found);
    });
    const change = 100 * (found.cost / start.cost - 1);
    $("cost").textContent = data.priced ? `${found.cost.toFixed(3)}` : "-";
    $("change").textContent = data.priced ? `${Live.signed(change, 1)} % from the allocated cost` : "";
    $("joint").textContent = found.joint === null ? "-" : percent(found.joint);
    if (found.x.some((x, k) => x !== 0 && data.parameters[k].place)) $("middles").parentElement.open = true;
    const broken = data.fields.filter((f) => f.nonnegative && Live.limitsOf(f, at).lower < -1e-9);
    const away = found.outside.map((p) => p.label);
    $("region").textContent = [
      away.length ? `Outside the region in which the error is known: ${away.join("; ")}. Compute it with rvjax.`
        : `Inside the region: ${data.error}.`,
      ...broken.map((f) => `${f.label}: below zero, not allowed in a study.`),
    ].join(" ");
    $("region").className = away.length || broken.length ? "live-region far" : "live-region";
    $("study").value = Live.study(data, at);
    $("bar").replaceChildren(element("span", {}, `cost ${$("cost").textContent}`), ...data.responses.map((r, k) => {
      const [main, , , , , sign] = judged[k].cells.map((cell) => cell.textContent);
      return element("span", { class: judged[k].cells[5].className }, `${r.label} ${main} ${sign.slice(0, 1)}`);
    }), ...(away.length ? [element("span", { class: "far" }, "outside the region")] : []));
    section.classList.toggle("as-allocated", found.x.every((x) => x === 0) &&
      data.responses.every((r, k) => at.limits[k].lower === r.own.lower && at.limits[k].upper === r.own.upper));
    clearTimeout(speaking); // a screen reader hears where the sliders came to rest, not every step
    speaking = setTimeout(() => {
      $("spoken").textContent = `Cost ${$("cost").textContent}. ` + data.responses.map((r, k) =>
        `${r.label}: ${judged[k].cells[0].textContent}, ${judged[k].cells[5].textContent}.`).join(" ") +
        (away.length ? " Outside the region." : "");
    }, 500);
  }

  function now() {
    waiting = false;
    const began = performance.now(), found = Live.all(data, at);
    section.dataset.computed = (performance.now() - began).toFixed(2);
    controls.forEach((refresh) => refresh());
    told(found);
    section.dataset.shown = (performance.now() - began).toFixed(2);
  }

  function follow() {
    if (!waiting) setTimeout(now); // not with the next frame: a page out of sight draws none, and what it says must hold
    waiting = true;
  }

  section.addEventListener("click", (event) => {
    const wanted = event.target.dataset?.begin;
    if (wanted) { restored.forEach((forget) => forget()); at = Live.begin(data, wanted); follow(); }
  });
  $("download").addEventListener("click", () => {
    const link = element("a", { download: `${data.name}.toml`,
      href: URL.createObjectURL(new Blob([$("study").value], { type: "text/plain" })) });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  });
  section.hidden = false;
  now();
}

if (typeof document !== "undefined") {
  const data = document.getElementById("live-data"), section = document.getElementById("live");
  if (data && section) startLive(section, Live.opened(JSON.parse(data.textContent)));
}
