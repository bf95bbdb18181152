// The plots: one figure, a cursor that all of them share, the way back in time, and the picture.
'use strict';
const CHANNELS = [
  { name: 'δx', unit: 'µm' }, { name: 'δy', unit: 'µm' }, { name: 'γ', unit: 'µrad' },
];
const LOAD_PLOT = 6;
// Plots 0 to 2 are displacements over load, 3 to 5 residuals over time, 6 is the load over time.
const isTimed = (plot) => plot >= CHANNELS.length;
const isResidual = (plot) => isTimed(plot) && plot !== LOAD_PLOT;
const suffixOf = (plot) => (plot ? plot + 1 : '');
const SETTINGS = { responsive: true, displaylogo: false, displayModeBar: true, showTips: false,
  modeBarButtonsToRemove: ['select2d', 'lasso2d', 'autoScale2d', 'toImage'] };
const DARK = matchMedia('(prefers-color-scheme: dark)');
const REDRAW = [400, 2000]; // A slow machine draws for a quarter of its time, but within 2 s.
const colours = {};
const figure = document.getElementById('plots');

const newCurves = () => ({ width: 0.01, origin: 0, load: new Map(), measured: new Map(),
  simulated: new Map(), residual: new Map() });
let boot = '';
let streams = newCurves(); // of the test that runs, or of the last one
let earlier = null; // curves of an earlier test that is looked at
let rig = { fullLoad: 25, unit: 't', range: [], allowed: [], band: [] };
let span = null; // the time that is looked at [s]; null: all, or the last seconds
let cursor = null; // number of a cell
let revision = 0;
let stale = true;

const curves = () => earlier ?? streams;
const timeOf = (cell) => (cell + 0.5) * curves().width;

function add(message, to) {
  to.width = message.width;
  to.origin = message.origin;
  for (const [name, found] of Object.entries(message.streams)) {
    found.cell.forEach((cell, i) => {
      to[name].set(cell, {
        mean: found.mean.map((row) => row[i]),
        low: found.low.map((row) => row[i]),
        high: found.high.map((row) => row[i]),
      });
    });
  }
  return to;
}

function take(message) {
  if (message.anew || message.boot !== boot) streams = newCurves();
  boot = message.boot;
  add(message, streams);
  document.body.dataset.cells = streams.residual.size;
  stale = true;
}

// Cells of a stream in order; a stretch ends where for more than a second nothing came.
function stretches(name) {
  const found = [];
  let before = -Infinity;
  for (const entry of [...curves()[name]].sort((a, b) => a[0] - b[0])) {
    if ((entry[0] - before - 1) * curves().width > 1) found.push([]);
    found.at(-1).push(entry);
    before = entry[0];
  }
  return found;
}

function points(name, of) {
  const rows = stretches(name).flatMap((cells, i) => [
    ...(i ? [[null, null, null]] : []),
    ...cells.map((entry) => of(entry) && [...of(entry), entry[0]]).filter(Boolean)]);
  return { x: rows.map((row) => row[0]), y: rows.map((row) => row[1]),
    customdata: rows.map((row) => row[2]) };
}

const loop = (name, row, shown) => points(name, ([cell, values]) => {
  const load = curves().load.get(cell);
  const time = timeOf(cell);
  return load && (!shown || (time >= shown[0] && time <= shown[1]))
    && [load.mean[0], values.mean[row]];
});

const means = (name, row) => points(name, ([cell, values]) => [timeOf(cell), values.mean[row]]);

function extremes(name, row) {
  const found = { x: [], y: [] };
  for (const stretch of stretches(name)) {
    const cells = stretch.filter(([, values]) => values.low[row] !== null);
    const at = cells.map(([cell]) => timeOf(cell));
    found.x.push(...at, ...[...at].reverse(), null);
    found.y.push(...cells.map(([, values]) => values.low[row]),
      ...cells.map(([, values]) => values.high[row]).reverse(), null);
  }
  return found;
}

// The time that is looked at; null for all of it.
function shownTime() {
  const last = +document.getElementById('follow').value;
  if (span || !last || earlier) return span;
  const newest = Math.max(0, ...streams.load.keys()) * streams.width;
  return [Math.max(0, newest - last), Math.max(newest, last)];
}

function traces() {
  const shown = shownTime();
  const trace = (found, plot, colour, name, line) => ({ ...found, type: 'scatter', mode: 'lines',
    name, line: { color: colour, ...line }, xaxis: `x${suffixOf(plot)}`,
    yaxis: `y${suffixOf(plot)}`, hovertemplate: `%{x:.3f}<br>%{y:.3f}<extra>${name}</extra>` });
  return [
    ...CHANNELS.flatMap((_, row) => [
      { ...trace(loop('measured', row, shown), row, colours.measured, 'measured', { width: 5 }),
        opacity: 0.5 },
      trace(loop('simulated', row, shown), row, colours.simulated, 'simulated', { width: 1.6 })]),
    ...CHANNELS.flatMap((_, row) => [
      { ...trace(extremes('residual', row), row + 3, colours.simulated, '', { width: 0 }),
        fill: 'toself', fillcolor: `${colours.simulated}33`, hoverinfo: 'skip' },
      trace(means('residual', row), row + 3, colours.simulated, 'residual', { width: 1.6 })]),
    trace(means('load', 0), LOAD_PLOT, colours.measured, 'load', { width: 2 })];
}

// Where each plot stands [px]: left, top, width, height; three beside each other if they fit.
function boxes(room) {
  const first = room < 1100 ? 50 : 26; // the buttons stand beside the titles if they fit
  if (room < 640) {
    let top = first;
    return [LOAD_PLOT, 0, 3, 1, 4, 2, 5].map((plot) => {
      const height = isTimed(plot) ? 120 : 190;
      top += height + 56;
      return [plot, { left: 46, top: top - height - 56, width: room - 56, height }];
    }).sort((a, b) => a[0] - b[0]).map((it) => it[1]);
  }
  const height = Math.min(Math.max(innerHeight - 300, 520), 1300) - 176;
  const width = (room - 176) / 3;
  const rows = [[first, 0.5 * height], [first + 60 + 0.5 * height, 0.3 * height]];
  return [...rows.flatMap(([top, tall]) => CHANNELS.map((_, i) => (
    { left: 52 + i * (width + 56), top, width, height: tall }))),
  { left: 52, top: first + 120 + 0.8 * height, width: room - 64, height: 0.2 * height }];
}

function titleOf(plot) {
  const began = curves().origin ? ` since ${clockTime(curves().origin)}` : '';
  if (plot === LOAD_PLOT) return `load / ${rig.unit} over time / s${began}`;
  const { name, unit } = CHANNELS[plot % 3];
  return isResidual(plot) ? `residual ${name} / ${unit}` : `${name} / ${unit} over load / ${rig.unit}`;
}

// What every vertical axis shows at least: axes begin with the rig's range and not with the noise.
function least(plot) {
  if (plot === LOAD_PLOT) return [0, rig.fullLoad];
  if (!isTimed(plot)) return rig.range[plot]?.[0] === null ? [-2, 10] : rig.range[plot];
  const largest = Math.max(1.2 * (rig.allowed[plot - 3] ?? 0), 4 * (rig.band[plot - 3] ?? 0), 1);
  return [-largest, largest];
}

// Bands of the residuals, and the cursor of all plots.
function shapes() {
  const band = (plot, half, style) => (half ? [{ type: 'rect', xref: `x${suffixOf(plot)} domain`,
    yref: `y${suffixOf(plot)}`, x0: 0, x1: 1, y0: -half, y1: half, layer: 'below', ...style }] : []);
  const found = [3, 4, 5].flatMap((plot) => [
    ...band(plot, rig.allowed[plot - 3], { fillcolor: `${colours.allowed}22`,
      line: { color: colours.allowed, width: 1, dash: 'dot' } }),
    ...band(plot, 2 * rig.band[plot - 3], { fillcolor: colours.noise, opacity: 0.45,
      line: { width: 0 } })]);
  if (cursor === null) return found;
  const line = { color: colours.ink, width: 1.5 };
  for (let plot = 3; plot <= LOAD_PLOT; plot += 1) {
    found.push({ type: 'line', xref: `x${suffixOf(plot)}`, yref: `y${suffixOf(plot)} domain`,
      x0: timeOf(cursor), x1: timeOf(cursor), y0: 0, y1: 1, line });
  }
  const load = curves().load.get(cursor)?.mean[0];
  CHANNELS.forEach((_, plot) => {
    const value = curves().measured.get(cursor)?.mean[plot];
    if (load === undefined || value === undefined || value === null) return;
    found.push({ type: 'circle', xref: `x${suffixOf(plot)}`, yref: `y${suffixOf(plot)}`,
      xsizemode: 'pixel', ysizemode: 'pixel', xanchor: load, yanchor: value,
      x0: -6, x1: 6, y0: -6, y1: 6, line });
  });
  return found;
}

function layout() {
  const room = figure.clientWidth;
  const size = 0.82 * parseFloat(getComputedStyle(document.body).fontSize);
  const places = boxes(room);
  const height = Math.max(...places.map((box) => box.top + box.height)) + 30;
  figure.style.height = `${height}px`;
  const found = { width: room, height, margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false,
    font: { size, color: colours.ink }, paper_bgcolor: colours.card, plot_bgcolor: colours.card,
    hovermode: 'closest', hoverdistance: 60, uirevision: `${revision}`, shapes: shapes(),
    dragmode: matchMedia('(pointer: coarse)').matches ? false : 'zoom', annotations: [],
    modebar: { bgcolor: 'rgba(0,0,0,0)', color: colours.soft, activecolor: colours.ink } };
  const shown = shownTime();
  const style = { gridcolor: colours.line, zeroline: false, linecolor: colours.noise };
  places.forEach((box, plot) => {
    const suffix = suffixOf(plot);
    const left = box.left / room;
    const top = 1 - box.top / height;
    found[`xaxis${suffix}`] = { ...style, domain: [left, Math.min(left + box.width / room, 1)],
      anchor: `y${suffix}`,
      ...(!isTimed(plot) ? { autorangeoptions: { include: [0, rig.fullLoad] } }
        : shown ? { range: shown, autorange: false, uirevision: String(shown) }
          : { autorangeoptions: { include: [0, 10] } }),
      ...(isTimed(plot) && plot !== 3 ? { matches: 'x4' } : {}) };
    found[`yaxis${suffix}`] = { ...style, domain: [Math.max(top - box.height / height, 0), top],
      anchor: `x${suffix}`, nticks: 6, autorangeoptions: { include: least(plot) } };
    found.annotations.push({ text: titleOf(plot), xref: `x${suffix} domain`, x: 0,
      xanchor: 'left', yref: `y${suffix} domain`, y: 1, yanchor: 'bottom', showarrow: false });
  });
  return found;
}

function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ['ink', 'soft', 'line', 'card', 'measured', 'simulated', 'noise', 'allowed']) {
    colours[name] = style.getPropertyValue(`--${name}`).trim();
  }
}

async function redraw() {
  stale = false;
  readColours();
  const isFirst = !figure.data;
  await Plotly.react(figure, traces(), layout(), SETTINGS);
  if (isFirst) follow();
  for (const button of document.querySelectorAll('.modebar-btn')) {
    button.tabIndex = 0;
    button.setAttribute('role', 'button');
    button.setAttribute('aria-label', button.dataset.title);
  }
  document.body.dataset.points = figure.data[0].x.length;
  document.getElementById('back').hidden = !span && !earlier;
  readOut();
}

// Draw when there is news; at once after an action of the user.
async function draw(isAsked = false) {
  let took = 0;
  if ((stale || isAsked) && !document.hidden && window.Plotly) {
    const began = performance.now();
    await redraw();
    took = performance.now() - began;
  }
  if (!isAsked) setTimeout(draw, Math.min(Math.max(REDRAW[0], 3 * took), REDRAW[1]));
}

// Follow what is done in the figure: a pointed value is the cursor, a zoomed time the span.
function follow() {
  figure.on('plotly_hover', ({ points: [point] }) => {
    if (point.customdata !== undefined) moveCursor(point.customdata);
  });
  figure.on('plotly_relayout', (change) => {
    for (const [key, value] of Object.entries(change)) {
      const axis = /^xaxis([4-7])\.(range\[0\]|range|autorange)$/.exec(key);
      if (!axis) continue;
      span = axis[2] === 'autorange' ? null : Array.isArray(value) ? [...value]
        : [value, change[`xaxis${axis[1]}.range[1]`]];
      draw(true);
      return;
    }
  });
}

function moveCursor(cell) {
  if (cell === cursor) return;
  cursor = cell;
  readOut();
  if (figure.layout) Plotly.relayout(figure, { shapes: shapes() });
}

function readOut() {
  if (cursor === null || !curves().load.has(cursor)) return;
  const number = (value, digits) => (value === undefined || value === null ? '–'
    : value.toFixed(digits));
  const of = (name) => curves()[name].get(cursor)?.mean ?? [];
  const time = timeOf(cursor);
  document.getElementById('readout').textContent = [
    `${time.toFixed(3)} s, ${clockTime(curves().origin + 1e3 * time, 3)}`,
    `load ${number(of('load')[0], 3)} ${rig.unit}`,
    ...CHANNELS.map(({ name, unit }, row) => `${name} ${number(of('measured')[row], 2)} ${unit}, `
      + `simulated ${number(of('simulated')[row], 2)}, residual ${number(of('residual')[row], 2)}`),
  ].join('; ');
}

function returnToNow() {
  earlier = span = cursor = null;
  revision += 1;
  showTests();
  draw(true);
}

async function lookAt(number) {
  const answer = await fetch(`tests/${number}`);
  if (!answer.ok) return;
  const found = await answer.json();
  returnToNow();
  earlier = { ...add(found, newCurves()), number };
  showTests();
  draw(true);
}

function zoom(factor) {
  const [from, to] = shownTime() ?? figure.layout.xaxis4.range;
  const middle = cursor === null ? (from + to) / 2 : timeOf(cursor);
  span = [middle - factor * (middle - from), middle + factor * (to - middle)];
  draw(true);
}

const KEYS = { ArrowLeft: -1, ArrowRight: 1 };

figure.addEventListener('keydown', (event) => {
  if (event.key === '+' || event.key === '-') {
    zoom(event.key === '+' ? 0.5 : 2);
  } else if (event.key === 'Escape') {
    returnToNow();
  } else if (event.key in KEYS) {
    const cells = [...curves().load.keys()].sort((a, b) => a - b);
    const step = Math.max(1, Math.round(cells.length / (event.shiftKey ? 20 : 200)));
    const at = cells.indexOf(cursor);
    const next = at < 0 ? cells.length - 1 : at + KEYS[event.key] * step;
    moveCursor(cells[Math.min(Math.max(next, 0), cells.length - 1)]);
  } else if (event.key === 'Enter' && event.target.matches('.modebar-btn')) {
    event.target.click();
  } else {
    return;
  }
  event.preventDefault();
});

async function savePicture() {
  await redraw();
  const title = document.getElementById('shown').textContent;
  await Plotly.downloadImage({ data: figure.data, layout: { ...figure.layout,
    height: figure.layout.height + 40, margin: { l: 0, r: 0, t: 40, b: 0 },
    title: { text: title, x: 0.01, y: 1, yanchor: 'top', pad: { t: 10 } } } },
  { format: 'png', width: figure.layout.width, height: figure.layout.height + 40, scale: 2,
    filename: title.replace(/[^\w.-]+/g, '_') });
}
