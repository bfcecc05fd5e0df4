"use strict";
// Shows the table of a library: sorted and filtered, a distribution above each column.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const PAGE = 200, BINS = 14, KINDS = 6;
  const [thead, tbody] = [document.querySelector("thead"), document.querySelector("tbody")];
  const filter = document.getElementById("filter"), more = document.getElementById("more");
  let command = Object.keys(data)[0], sorted = null, descending = true, shown = PAGE;

  const make = (name, attributes = {}, ...children) => {
    const svg = ["svg", "path", "rect", "title"].includes(name);
    const one = svg ? document.createElementNS("http://www.w3.org/2000/svg", name) : document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) {
      if (key === "onclick") one.addEventListener("click", value);
      else one.setAttribute(key, value);
    }
    one.append(...children);
    return one;
  };
  const said = (value) => value === true ? "yes" : value === false ? "no" : value ?? "";
  const figure = (value) => Number.isInteger(value) ? String(value)
    : Math.abs(value) >= 1000 ? value.toFixed(0) : String(Number(value.toPrecision(3)));
  const index = (name) => data[command].columns.findIndex((column) => column.name === name);
  const isNumber = (place) => data[command].rows.some((row) => typeof row[place] === "number");

  // A test of rows for each word of the filter: `column>number`, `column=beginning`,
  // `column="all of it"`, or text anywhere.
  const words = () => filter.value.match(/(?:[^\s"]|"[^"]*"?)+/g) ?? [];
  const tests = () => words().map((typed) => {
    const word = typed.toLowerCase().replaceAll('"', "");
    const [, name, sign, value] = word.match(/^([\w.]+)(<=|>=|<|>|=)(.*)$/) ?? [];
    const fits = typed.includes('"') ? (text) => text === value : (text) => text.startsWith(value);
    const place = name ? index(name) : -1;
    if (place < 0) return (row) => row.some((cell, i) =>
      typeof cell === "string" && data[command].columns[i].name !== "picture" && cell.toLowerCase().includes(word));
    const number = Number(value);
    return (row) => {
      const cell = row[place];
      if (cell === null) return false;
      if (sign === "=") return typeof cell === "number" ? cell === number : fits(said(cell).toLowerCase());
      return { "<": cell < number, ">": cell > number, "<=": cell <= number, ">=": cell >= number }[sign];
    };
  });
  const rows = () => {
    const all = tests(), found = data[command].rows.filter((row) => all.every((test) => test(row)));
    if (sorted === null) return found; // worst first, as they come
    const place = index(sorted), way = descending ? -1 : 1;
    return found.sort((a, b) => {
      const [x, y] = [a[place], b[place]];
      if (x === null || y === null) return (x === null) - (y === null);
      return x < y ? -way : x > y ? way : 0;
    });
  };
  const also = (...conditions) => {
    const names = conditions.map((condition) => condition.match(/^[\w.]+/)[0] + "");
    const kept = words().filter((word) => !names.includes(word.match(/^[\w.]*/)[0]));
    filter.value = [...kept, ...conditions].join(" ");
    update();
  };

  const histogram = (column, values) => {
    let [low, high] = [Infinity, -Infinity]; // a spread of 10,000 values is too long for Math.min
    for (const value of values) [low, high] = [Math.min(low, value), Math.max(high, value)];
    if (low === high) return [make("small", {}, `all ${figure(low)}`)];
    // Bars begin at rounded numbers, which the filter shows; the first and the last have no end.
    const begins = Array.from({ length: BINS }, (_, bin) =>
      bin ? Number((low + bin * (high - low) / BINS).toPrecision(4)) : -Infinity);
    const counts = new Array(BINS).fill(0);
    for (const value of values) counts[begins.findLastIndex((begin) => value >= begin)] += 1;
    const most = Math.max(...counts), svg = make("svg", { viewBox: "0 0 84 28" });
    counts.forEach((count, bin) => {
      const height = count ? Math.max(1, 26 * count / most) : 0;
      const [from, to] = [begins[bin], begins[bin + 1] ?? Infinity];
      svg.append(make("rect", {
        x: 6 * bin, y: 28 - height, width: 5, height,
        onclick: () => also(...[
          bin > 0 && `${column.name}>=${from}`, bin < BINS - 1 && `${column.name}<${to}`,
        ].filter(Boolean)),
      }, make("title", {},
        `${count}: ${figure(Math.max(from, low))} to ${figure(Math.min(to, high))} ${column.unit}`)));
    });
    return [svg, make("small", {}, `${figure(low)} to ${figure(high)}`)];
  };
  const kinds = (column, values) => {
    const counts = new Map();
    for (const value of values) counts.set(said(value), (counts.get(said(value)) ?? 0) + 1);
    if (counts.size > KINDS) return [];
    return [make("div", { class: "kinds" }, ...[...counts].sort((a, b) => b[1] - a[1]).map(([kind, count]) =>
      make("button", { onclick: () => also(`${column.name}="${kind}"`) }, `${count} ${kind}`)))];
  };
  const heading = (column, place, found) => {
    const values = found.map((row) => row[place]).filter((value) => value !== null);
    const number = isNumber(place), plain = ["picture", "name", "path", "causes", "report", "output"].includes(column.name);
    const drawn = plain || !values.length ? []
      : number ? histogram(column, values) : kinds(column, values);
    const mark = sorted !== column.name ? "" : descending ? " ▼" : " ▲";
    const sort = () => {
      descending = sorted === column.name ? !descending : true;
      sorted = column.name;
      update();
    };
    return make("th", { title: column.about, scope: "col", class: number ? "" : "text" },
      make("button", { onclick: sort }, column.name.replaceAll("_", " ") + mark),
      make("small", {}, column.unit), ...drawn);
  };
  // Of what failed, the reason is in place of the columns behind it, and the path is a tooltip of the name.
  const row = (values) => {
    const { columns } = data[command], reason = index("reason"), path = values[index("path")];
    const failed = reason >= 0 && values[reason] !== null;
    const shown = columns.filter((_, i) => i !== reason && (i < reason || !failed));
    const cells = shown.map((column) =>
      cell(column, values[index(column.name)], column.name === "name" ? path : undefined));
    if (failed) cells.push(make("td", { class: "reason", colspan: columns.length - 1 - reason }, values[reason]));
    return make("tr", {}, ...cells);
  };
  const cell = (column, value, title = said(value)) => {
    if (value === null) return make("td");
    if (column.name === "picture")
      return make("td", {}, make("svg", { viewBox: "0 0 100 30" }, make("path", { d: value })));
    if (column.name === "report" || column.name === "output")
      return make("td", {}, make("a", { href: value.split("/").map(encodeURIComponent).join("/") }, column.name));
    if (typeof value === "number") return make("td", {}, figure(value));
    const bad = column.name === "status" ? value !== "ok" : value === "no" || value === false;
    return make("td", { class: bad ? "text bad" : "text", title }, said(value));
  };
  const update = () => {
    const { columns } = data[command], found = rows();
    thead.replaceChildren(make("tr", {}, ...columns.flatMap((column, i) =>
      column.name === "reason" ? [] : [heading(column, i, found)])));
    tbody.replaceChildren(...found.slice(0, shown).map(row));
    document.getElementById("count").textContent = `${found.length} of ${data[command].rows.length}`;
    more.hidden = found.length <= shown;
    document.documentElement.dataset.drawn = found.length;
  };
  const choose = (name) => {
    [command, sorted, shown] = [name, null, PAGE];
    document.getElementById("commands").replaceChildren(...Object.keys(data).map((one) =>
      make("button", { "aria-pressed": one === command, onclick: () => choose(one) }, one)));
    update();
  };
  filter.addEventListener("input", () => { shown = PAGE; update(); });
  more.addEventListener("click", () => { shown += 5 * PAGE; update(); });
  choose(command);
})();
