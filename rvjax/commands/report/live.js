"use strict";
/* Sliders of the page: everything follows from the numbers in #live-data. No library, no network. */

const Live = (() => {
  /* A column as it was packed: 16-bit integers and their scale, or 32-bit floats. */
  function unpacked(packed) {
    const bytes = Uint8Array.from(atob(packed.data), (c) => c.charCodeAt(0));
    if (packed.scale === undefined) return Float64Array.from(new Float32Array(bytes.buffer));
    return Float64Array.from(new Int16Array(bytes.buffer), (n) => n * packed.scale);
  }

  function opened(data) {
    data.weights = unpacked(data.weights);
    const sum = data.weights.reduce((a, b) => a + b, 0); // 1 but for 32 bits
    data.weights = data.weights.map((weight) => weight / sum);
    for (const response of data.responses) {
      response.base = unpacked(response.base);
      for (const column of response.columns) column.values = unpacked(column);
    }
    return data;
  }

  /* Parameters in reaches off the allocated ones; within -1 .. 1 the error was measured. */
  const places = (data, at) => data.parameters.map((p, k) => (at.parameters[k] - p.centre) / p.reach);

  function values(response, x) {
    const found = response.base.slice();
    for (const { terms, values: column } of response.columns) {
      const factor = terms.reduce((product, k) => product * x[k], 1);
      if (factor !== 0) for (let i = 0; i < found.length; i++) found[i] += factor * column[i];
    }
    return found;
  }

  const within = (y, limit) => (limit.lower === null || y >= limit.lower) && (limit.upper === null || y <= limit.upper);

  /* What a requirement judges, and the moments of the valid units. */
  function figures(data, response, y, limit) {
    const w = data.weights;
    let mean = 0, square = 0, share = 0;
    for (let i = 0; i < y.length; i++) {
      mean += w[i] * y[i];
      if (within(y[i], limit)) share += w[i];
    }
    for (let i = 0; i < y.length; i++) square += w[i] * (y[i] - mean) ** 2;
    const sd = Math.sqrt(square);
    const room = Math.min(
      limit.upper === null ? Infinity : limit.upper - mean, limit.lower === null ? Infinity : mean - limit.lower);
    const found = { mean, sd, yield: (1 - data.failed) * share, cpk: room / (3 * sd) };
    found.met = { share: found.yield >= response.wanted, cpk: found.cpk >= response.wanted, mean: within(mean, limit),
      sd: sd <= limit.upper }[response.kind];
    return found;
  }

  /* Of all requirements on units at once. */
  function joint(data, all, at) {
    const judged = data.responses.map((r, k) => [all[k], at.limits[k], r]).filter(([, , r]) => r.of_units);
    let share = 0;
    for (let i = 0; i < data.weights.length; i++)
      if (judged.every(([y, limit]) => within(y[i], limit))) share += data.weights[i];
    return judged.length ? (1 - data.failed) * share : null;
  }

  const limitsOf = (field, at) => {
    const half = at.parameters[field.half] / (field.half_widths ?? 1);
    const place = field.place === null ? field.stands : at.parameters[field.place];
    const lower = field.grows ? place : place - half;
    return { half, lower, upper: lower + 2 * half, middle: lower + half };
  };

  /* Linear in log cost over log half-width; constant beyond the ends. */
  function between(points, half) {
    const k = points.findIndex(([t]) => t >= half);
    if (k <= 0) return points[k === 0 ? 0 : points.length - 1][1];
    const [[t, c], [u, d]] = [points[k - 1], points[k]];
    return c * (d / c) ** (Math.log(half / t) / Math.log(u / t));
  }

  function cost(data, at) {
    let total = data.other_cost;
    for (const field of data.fields) {
      const { half, middle } = limitsOf(field, at), c = field.cost;
      if (c && c.points) total += between(c.points, half);
      else if (c) total += c.fixed + c.scale *
        (c.decay === undefined ? (c.reference / half) ** c.power : Math.exp(-half / c.decay));
      if (field.moving) total += field.moving.scale * Math.abs(middle - field.moving.given);
    }
    return total;
  }

  /* Shares of the variance: to first order each grows as the square of its half-width. */
  function shares(data, response, at) {
    const parts = data.fields.map((f) =>
      (response.shares[f.name] ?? 0) * (at.parameters[f.half] / data.parameters[f.half].centre) ** 2);
    const sum = parts.reduce((a, b) => a + b, 0);
    return parts.map((part) => (sum > 0 ? part / sum : 0));
  }

  const number = (value) => String(Number(value.toPrecision(6)));
  const quantity = (value, unit) => (unit === "-" ? number(value) : `"${number(value)} ${unit}"`);
  const same = (a, b, size) => a === b || Math.abs(a - b) <= 1e-9 * size;

  /* The study with these tolerances and limits; what has not changed keeps its own words. */
  function study(data, at) {
    if (!data.template) return "# This page cannot write this study: change the study by hand.\n";
    return data.template.map((part) => {
      if (typeof part === "string") return part;
      if (part.field !== undefined) {
        const field = data.fields[part.field], { half, lower, upper } = limitsOf(field, at);
        const [low, high] = field.own;
        if (same(lower, low, half) && same(upper, high, half)) return part.own;
        if (field.drawing && (same(lower, -upper, half) || same(lower, 0, half))) {
          const [word, before] = field.drawing.split(" ");
          const size = `${number(field.half_widths * half)} ${field.unit}`;
          return `${word} = "${before ? `${before} ` : ""}${size}"\n`;
        }
        if (same(lower, -upper, half)) return `half_width = ${quantity(half, field.unit)}\n`;
        return `lower = ${quantity(lower, field.unit)}\nupper = ${quantity(upper, field.unit)}\n`;
      }
      const response = data.responses[part.response], limit = at.limits[part.response];
      if (["lower", "upper"].every((end) => limit[end] === response.own[end])) return part.own;
      return ["lower", "upper"].filter((end) => limit[end] !== null)
        .map((end) => `${response.prefix}${end} = ${quantity(limit[end], response.unit)}\n`).join("");
    }).join("");
  }

  const begin = (data, key) => ({
    parameters: data.parameters.map((p) => (p[key] ?? p.centre)),
    limits: data.responses.map((r) => ({ ...r.own })),
  });

  function all(data, at) {
    const x = places(data, at), y = data.responses.map((r) => values(r, x));
    return {
      x, y, cost: cost(data, at), joint: joint(data, y, at),
      figures: data.responses.map((r, k) => figures(data, r, y[k], at.limits[k])),
      shares: data.responses.map((r) => shares(data, r, at)),
      outside: data.parameters.filter((_, k) => Math.abs(x[k]) > 1 + 1e-9),
    };
  }

  /* A change with its sign; what rounds to nothing has none. */
  const signed = (value, digits) => new Intl.NumberFormat("en", {
    minimumFractionDigits: digits, maximumFractionDigits: digits, signDisplay: "exceptZero", useGrouping: false,
  }).format(value);

  /* The number that a slider takes, and why it is not the one that was typed; null where there is none. */
  function taken(wanted, low, high, shown) {
    if (!Number.isFinite(wanted)) return { value: null, said: "no number: not changed" };
    const value = Math.min(high, Math.max(low, wanted));
    const said = `${shown(wanted)} is outside ${shown(low)} to ${shown(high)}: set to ${shown(value)}`;
    return { value, said: value === wanted ? "" : said };
  }

  /* Span of values; where their middle 90 % is less than a twentieth of it, two of its widths to each side. */
  function ends(y) {
    const sorted = Array.from(y).sort((a, b) => a - b), n = sorted.length - 1;
    const [low, first, last, high] = [0, 0.05, 0.95, 1].map((share) => sorted[Math.round(share * n)]);
    const body = last - first;
    if (!(body > 0 && body < (high - low) / 20)) return [low, high];
    return [Math.max(low, first - 2 * body), Math.min(high, last + 2 * body)];
  }

  /* Weights of the values in each bin of a span; what lies outside is in none. */
  function counted(y, weights, [low, high], count) {
    const bins = new Float64Array(count);
    for (let i = 0; i < y.length; i++)
      if (y[i] >= low && y[i] <= high)
        bins[Math.min(count - 1, Math.floor(((y[i] - low) / (high - low)) * count))] += weights[i];
    return bins;
  }

  return { ends, counted, opened, begin, all, cost, study, limitsOf, values, places, signed, taken };
})();

if (typeof module !== "undefined") module.exports = Live;
