/* Sliders of a design: a linear prediction about its optimum. The costs of half-widths come from Live.cost. */

const LiveDesign = (() => {
  const begin = (data, key) => data.sliders.map((slider) => slider[key]);

  function predicted(data, at) {
    const moved = data.sliders.map((slider, k) => at[k] - slider.centre);
    const along = (slopes) => slopes.reduce((sum, slope, k) => sum + slope * moved[k], 0);
    const nominal = data.nominal.map((row) => {
      const value = row.value + along(row.slopes), slack = 1e-3 * Math.max(Math.abs(row.value), Math.abs(value));
      const met = (row.lower === null || value >= row.lower - slack) && (row.upper === null || value <= row.upper + slack);
      return { value, met, judged: row.lower !== null || row.upper !== null };
    });
    const units = data.units.map((row) => {
      const distance = -(row.margin + along(row.slopes));
      return { distance, met: distance >= -2e-3 * row.scale };
    });
    const widths = (x) => Live.cost(data, { parameters: x });
    const own = along(data.sliders.map((slider) => slider.own));
    const priced = data.nominal.reduce((sum, row, k) => sum + row.price * (nominal[k].value - row.value), 0);
    const cost = data.cost + widths(at) - widths(begin(data, "centre")) + own + priced;
    const far = data.sliders.filter((slider, k) => Math.abs(moved[k]) > slider.reach * (1 + 1e-9));
    return { cost, nominal, units, far };
  }

  return { begin, predicted };
})();

function startDesign(section, data) {
  const $ = (name) => section.querySelector(`[data-live="${name}"]`);
  const read = (value) => String(Number(value.toPrecision(4)));
  const shown = (value, unit) => `${read(value)}${unit === "-" ? "" : ` ${unit.replace(/^u(?=m)/, "µ")}`}`;
  const element = (tag, attributes = {}, ...children) => {
    const made = document.createElement(tag);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  };
  const restored = [];
  let at = LiveDesign.begin(data, "centre"), speaking = 0;
  const refresh = data.sliders.map((slider, k) => {
    const id = `design-${k}`, step = 10 ** Math.floor(Math.log10((slider.high - slider.low) / 100));
    const range = element("input", { type: "range", id, min: slider.low, max: slider.high, step: step / 10 });
    const exact = element("input", { type: "number", step: "any", "aria-label": `${slider.label}, exact, ${slider.unit}` });
    const value = element("output", { for: id }), mark = element("span", { class: "far" });
    const row = element("div", { class: "live-row" }, element("label", { for: id }, slider.label), value, range, exact, mark);
    $(slider.number ? "numbers" : "half-widths").append(row);
    let refused = "";
    range.addEventListener("input", () => { refused = ""; at[k] = Number(range.value); tell(); });
    exact.addEventListener("change", () => {
      const { value: wanted, said } = Live.taken(exact.valueAsNumber, slider.low, slider.high, (x) => shown(x, slider.unit));
      refused = said;
      if (wanted !== null) at[k] = wanted;
      if (said) exact.value = read(at[k]); // the field has the focus, and is not written again
      tell();
    });
    restored.push(() => { refused = ""; });
    return () => {
      range.value = at[k];
      range.setAttribute("aria-valuetext", shown(at[k], slider.unit));
      if (document.activeElement !== exact) exact.value = read(at[k]);
      value.textContent = shown(at[k], slider.unit);
      const far = Math.abs(at[k] - slider.centre) > slider.reach * (1 + 1e-9);
      mark.textContent = [refused, far ? "far from the optimum" : ""].filter(Boolean).join("; ");
    };
  });
  const tabled = (name, rows, titles, text) => rows.map((row) => {
    const cells = titles.map((title) => element("td", { "data-label": title }));
    $(name).append(element("tr", {}, element("th", { scope: "row" }, row.label), ...cells));
    return (found) => {
      text(row, found).forEach((words, i) => { cells[i].textContent = words; });
      cells[cells.length - 1].className = found.met ? "met" : "missed-mark";
    };
  });
  const verdict = (found) => (found.met ? "✔ met" : "✘ not met");
  const units = tabled("units", data.units, ["limit", "required", "distance", "verdict"],
    (row, found) => [row.limit, row.required, shown(found.distance, row.unit), verdict(found)]);
  const nominal = tabled("nominal", data.nominal, ["limit", "value", "verdict"],
    (row, found) => [row.limit, shown(found.value, row.unit), found.judged ? verdict(found) : "-"]);

  function tell() {
    const found = LiveDesign.predicted(data, at), change = found.cost - data.cost;
    refresh.forEach((one) => one());
    units.forEach((one, k) => one(found.units[k]));
    nominal.forEach((one, k) => one(found.nominal[k]));
    $("cost").textContent = found.cost.toFixed(3);
    $("change").textContent = `${Live.signed(change, 3)} compared with the optimum`;
    $("region").textContent = found.far.length
      ? `Far from the optimum, the prediction is rough: ${found.far.map((slider) => slider.label).join("; ")}.`
      : "Near the optimum.";
    $("region").className = found.far.length ? "live-region far" : "live-region";
    clearTimeout(speaking); // a screen reader hears where the sliders came to rest
    speaking = setTimeout(() => {
      $("spoken").textContent = `Predicted cost ${$("cost").textContent}. ${$("region").textContent}`;
    }, 500);
  }

  section.addEventListener("click", (event) => {
    const wanted = event.target.dataset?.begin;
    if (wanted) { restored.forEach((forget) => forget()); at = LiveDesign.begin(data, wanted); tell(); }
  });
  section.hidden = false;
  tell();
}

if (typeof document !== "undefined") {
  const data = document.getElementById("live-data"), section = document.getElementById("design-live");
  if (data && section) startDesign(section, JSON.parse(data.textContent));
}

if (typeof module !== "undefined") module.exports = { Live, LiveDesign };
