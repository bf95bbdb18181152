// Draws what the server says. The server alone knows; a reload or a lost connection starts from it.
'use strict';
const CHANNELS = [
  { name: 'δx', unit: 'µm', row: 0 },
  { name: 'δy', unit: 'µm', row: 1 },
  { name: 'γ', unit: 'µrad', row: 2 },
];
const colours = {};
const DARK = matchMedia('(prefers-color-scheme: dark)');
const MARKS = { ok: '✓', warning: '▲', error: '✗', silent: '…' };
const REDRAW = 400;

const byId = (id) => document.getElementById(id);
const make = (tag, text = '', kind = '') => {
  const element = document.createElement(tag);
  element.textContent = text;
  if (kind) element.className = kind;
  return element;
};
const post = (path) => fetch(path, { method: 'POST', headers: { 'X-Saddlering': 'live' } });

let boot = '';
let width = 0.01;
let forceUnit = 't';
let fullLoad = 25;
let band = [];
const opened = new Set();
let streams = {};
let stale = true;

function forget() {
  streams = { load: new Map(), measured: new Map(), simulated: new Map(), residual: new Map() };
}

function take(message) {
  if (message.anew || message.boot !== boot) forget();
  boot = message.boot;
  width = message.width;
  forceUnit = message.force_unit;
  fullLoad = message.full_load;
  for (const [name, found] of Object.entries(message.streams)) {
    found.cell.forEach((cell, i) => {
      streams[name].set(cell, {
        mean: found.mean.map((row) => row[i]),
        low: found.low.map((row) => row[i]),
        high: found.high.map((row) => row[i]),
      });
    });
  }
  document.body.dataset.cells = streams.residual.size;
  stale = true;
}

// Cells of a stream in order; a stretch ends where for more than a second nothing came.
function stretches(name) {
  const found = [];
  let before = -Infinity;
  for (const entry of [...streams[name]].sort((a, b) => a[0] - b[0])) {
    if ((entry[0] - before - 1) * width > 1) found.push([]);
    found.at(-1).push(entry);
    before = entry[0];
  }
  return found;
}

function points(name, of) {
  const rows = stretches(name).flatMap((cells, i) => [
    ...(i ? [[null, null]] : []), ...cells.map(of).filter(Boolean)]);
  return { x: rows.map((row) => row[0]), y: rows.map((row) => row[1]) };
}

const loop = (name, row) => points(name, ([cell, values]) => {
  const load = streams.load.get(cell);
  return load && [load.mean[0], values.mean[row]];
});

const means = (name, row) => points(
  name, ([cell, values]) => [(cell + 0.5) * width, values.mean[row]]);

function extremes(name, row) {
  const found = { x: [], y: [] };
  for (const stretch of stretches(name)) {
    const cells = stretch.filter(([, values]) => values.low[row] !== null);
    const at = cells.map(([cell]) => (cell + 0.5) * width);
    found.x.push(...at, ...[...at].reverse(), null);
    found.y.push(...cells.map(([, values]) => values.low[row]),
      ...cells.map(([, values]) => values.high[row]).reverse(), null);
  }
  return found;
}

const SETTINGS = { responsive: true, displaylogo: false, displayModeBar: true,
  modeBarButtonsToRemove: ['select2d', 'lasso2d', 'autoScale2d'] };
const LOAD_PLOT = 3;
const suffixOf = (i) => (i ? i + 1 : '');
const titleOf = (i) => (i === LOAD_PLOT ? `load / ${forceUnit}`
  : `${CHANNELS[i].name} / ${CHANNELS[i].unit}`);

function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ['ink', 'line', 'measured', 'simulated', 'noise']) {
    colours[name] = style.getPropertyValue(`--${name}`).trim();
  }
}

// Plots in as many columns as fit. `least` is what every vertical axis shows at least: the axes
// begin with it and not with the noise.
function layout(place, plots, across, least, low) {
  const room = byId(place).clientWidth;
  const columns = room < 560 ? 1 : room < 1100 && plots === 4 ? 2 : plots;
  const rows = Math.ceil(plots / columns);
  const each = low ? 230 : 310;
  byId(place).style.height = `${rows * each}px`;
  const found = {
    height: rows * each, margin: { l: 44, r: 12, t: 50, b: 40 },
    font: { size: 12, color: colours.ink }, paper_bgcolor: 'rgba(0,0,0,0)',
    plot_bgcolor: 'rgba(0,0,0,0)', showlegend: false, hovermode: 'closest', uirevision: 'kept',
    modebar: { bgcolor: 'rgba(0,0,0,0)', color: colours.measured, activecolor: colours.ink },
    shapes: [], annotations: [],
  };
  const inner = { x: Math.max(room - 56, 200), y: rows * each - 90 };
  const gap = { x: 56 / inner.x, y: 86 / inner.y };
  const size = { x: (1 - (columns - 1) * gap.x) / columns, y: (1 - (rows - 1) * gap.y) / rows };
  for (let i = 0; i < plots; i += 1) {
    const suffix = suffixOf(i);
    const left = (i % columns) * (size.x + gap.x);
    const top = 1 - Math.floor(i / columns) * (size.y + gap.y);
    const line = { gridcolor: colours.line, zeroline: false, linecolor: colours.noise };
    const axis = i === LOAD_PLOT ? 'time / s' : across;
    found[`xaxis${suffix}`] = { ...line, domain: [left, left + size.x], anchor: `y${suffix}`,
      title: { text: axis, standoff: 4 }, rangemode: 'normal',
      autorangeoptions: { include: axis === 'time / s' ? [0, 10] : [0, fullLoad] } };
    found[`yaxis${suffix}`] = { ...line, domain: [Math.max(top - size.y, 0), top],
      anchor: `x${suffix}`,
      autorangeoptions: { include: i === LOAD_PLOT ? [0, fullLoad] : least } };
    found.annotations.push({ text: titleOf(i), xref: `x${suffix} domain`, x: 0, xanchor: 'left',
      yref: `y${suffix} domain`, y: 1, yanchor: 'bottom', showarrow: false });
    if (low && band[i]) {
      found.shapes.push({ type: 'rect', xref: `x${suffix} domain`, yref: `y${suffix}`, x0: 0,
        x1: 1, y0: -2 * band[i], y1: 2 * band[i], line: { width: 0 },
        fillcolor: colours.noise, opacity: 0.35, layer: 'below' });
    }
  }
  return found;
}

function trace(points, i, colour, name, line = { width: 1.6 }) {
  const unit = i === LOAD_PLOT ? forceUnit : CHANNELS[i].unit;
  return { ...points, type: 'scatter', mode: 'lines', name, line: { color: colour, ...line },
    xaxis: `x${suffixOf(i)}`, yaxis: `y${suffixOf(i)}`,
    hovertemplate: `%{x:.3f}<br>%{y:.3f} ${unit}<extra>${name}</extra>` };
}

async function draw() {
  if (stale && !document.hidden && window.Plotly) {
    stale = false;
    readColours();
    const loops = CHANNELS.flatMap((channel, i) => [
      { ...trace(loop('measured', channel.row), i, colours.measured, 'measured', { width: 5 }),
        opacity: 0.5 },
      trace(loop('simulated', channel.row), i, colours.simulated, 'simulated', { width: 1.4 })]);
    loops.push(trace(means('load', 0), LOAD_PLOT, colours.measured, 'load'));
    const residuals = CHANNELS.flatMap((channel, i) => [
      { ...trace(extremes('residual', channel.row), i, colours.simulated, 'lowest to highest',
        { width: 0 }), fill: 'toself', fillcolor: 'rgba(209,73,91,0.2)', hoverinfo: 'skip' },
      trace(means('residual', channel.row), i, colours.simulated, 'mean')]);
    await Plotly.react('loops', loops, layout('loops', 4, `load / ${forceUnit}`, [-2, 10], false),
      SETTINGS);
    await Plotly.react('residuals', residuals,
      layout('residuals', 3, 'time / s', [-1, 1], true), SETTINGS);
    for (const button of document.querySelectorAll('.modebar-btn')) {
      button.tabIndex = 0;
      button.setAttribute('role', 'button');
      button.setAttribute('aria-label', button.dataset.title);
    }
    document.body.dataset.points = loops[0].x.length;
  }
  setTimeout(draw, REDRAW);
}

// New children, and the keyboard's focus where it was among them.
function renew(place, children) {
  const controls = () => [...place.querySelectorAll('button, summary')];
  const focused = controls().indexOf(document.activeElement);
  place.replaceChildren(...children);
  if (focused >= 0) controls()[focused]?.focus();
}

function showReplay(replay) {
  byId('replay').textContent = !replay ? 'No replay'
    : `Replay ${replay.state}, ${Math.round(100 * replay.share)} %`
      + (replay.state === 'playing' && replay.speed ? `, ${replay.speed} times real time` : '')
      + (replay.waiting_for.length ? `; ${replay.waiting_for[0]}` : '');
}

function gauge(title, value, words, level = 'ok', isOld = false) {
  const box = make('div', '', `gauge${level === 'ok' ? '' : ` ${level}`}${isOld ? ' old' : ''}`);
  box.append(make('span', title, 'soft'), make('b', value), make('span', words, 'soft'));
  return box;
}

function probeGauge(probe, number) {
  if (probe?.is_absent) return gauge(`Probe ${number}`, 'absent', 'the rig does not have it');
  if (!probe) return gauge(`Probe ${number}`, '–', 'None received');
  const margin = probe.margin === null ? 'span not stated' : `margin ${probe.margin.toFixed(3)} mm`;
  const box = gauge(`Probe ${number}`, `${probe.gap.toFixed(4)} mm`, margin, probe.level, probe.is_old);
  if (probe.margin !== null) {
    const bar = make('div', '', 'span');
    const mark = make('i');
    const share = (probe.gap - probe.low) / (probe.high - probe.low);
    mark.style.left = `${100 * Math.min(Math.max(share, 0), 1)}%`;
    bar.title = `${probe.low} to ${probe.high} mm`;
    bar.append(mark);
    box.append(bar);
  }
  return box;
}

const loadWords = (load, unit) => `${load[unit].toFixed(unit === 't' ? 2 : 1)} ${unit}`;

function showNow(now) {
  const { load, elevation, probes } = now.gauges;
  const time = new Date(now.ended / 1e6).toISOString().slice(11, 19);
  byId('test').textContent = (now.test ? `Test ${now.test}` : 'Test in progress')
    + (now.ended ? `: test ended ${time} UTC, last values` : '');
  document.querySelector('#now .gauges').replaceChildren(
    gauge('Load', load ? loadWords(load, forceUnit) : '–',
      load ? loadWords(load, forceUnit === 't' ? 'kN' : 't') : 'None received',
      'ok', load?.is_old),
    gauge('Elevation', elevation ? `${elevation.deg}°` : '–',
      elevation ? (elevation.is_measured ? 'measured' : 'as simulated') : 'None received',
      'ok', elevation?.is_old),
    ...probes.map((probe, i) => probeGauge(probe, i + 1)));
}

function showCommands(commands) {
  const words = [];
  for (const [name, command] of Object.entries(commands)) {
    byId(name).disabled = !command.ready;
    byId(name).title = command.words;
    if (command.words) words.push(`${name}: ${command.words}`);
  }
  byId('answer').textContent = words.join('; ');
}

function showParameters(parameters) {
  if (!parameters) return;
  byId('source').textContent = parameters.source;
  byId('parameters').replaceChildren(...parameters.rows.map(([name, value]) => {
    const row = make('tr');
    row.append(make('td', name), make('td', value));
    return row;
  }));
}

const RANK = { error: 0, warning: 1, silent: 2, ok: 3 };
const worst = (items) => items.reduce(
  (level, item) => (RANK[item.level] < RANK[level] ? item.level : level), 'ok');

function node(title, items, words) {
  const level = worst(items);
  const box = make('div', '', 'node');
  box.dataset.level = level;
  const text = make('div');
  text.append(make('b', title), ...words.map((line) => make('div', line.words, line.level)));
  box.append(make('span', MARKS[level], `mark ${level}`), text);
  return box;
}

function showHealth(health) {
  const probes = [1, 2, 3, 4].map((number) => {
    const items = health.filter((item) => item.name.endsWith(`/rig/eddy_current_${number}`)
      && item.name.includes('ring_displacement'));
    return items.length ? node(`probe ${number}`, items, items) : null;
  }).filter(Boolean);
  const parity = health.filter((item) => item.name.endsWith('ring_displacement: parity'));
  if (parity.length) probes.push(node('parity of probes 1 and 3', parity, parity));
  byId('probes').replaceChildren(...(probes.length ? probes
    : [make('p', 'ring_displacement: Node offline', 'soft')]));
  const names = [...new Set(health.map((item) => item.name.split(':')[0]))];
  renew(byId('nodes'), names.map((name) => {
    const items = health.filter((item) => item.name.split(':')[0] === name);
    const raised = items.filter((item) => item.level !== 'ok');
    if (!raised.length) return node(name, items, [{ level: 'ok', words: 'OK' }]);
    if (raised.length === items.length && raised.every((item) => item.level === 'silent')) {
      return node(name, items, [raised[0]]);
    }
    return folded(name, items, raised);
  }));
}

function folded(name, items, raised) {
  const box = node(name, items, []);
  const details = make('details');
  const count = raised.length === 1 ? '1 warning' : `${raised.length} warnings`;
  details.open = opened.has(name);
  details.addEventListener('toggle', () => (details.open ? opened.add(name)
    : opened.delete(name)));
  details.append(make('summary', count, worst(raised)), ...raised.map((item) => make('div',
    `${item.name.split(': ')[1]}: ${item.words}`, item.level)));
  box.lastElementChild.append(details);
  return box;
}

const minutes = (seconds) => (seconds < 90 ? `${Math.round(seconds)} s`
  : `${Math.round(seconds / 60)} min`);

function showJob(name, job) {
  const box = make('div', '', 'job');
  box.dataset.action = name;
  box.dataset.state = job.state;
  const head = make('div');
  head.append(make('b', `${name}: ${job.state === 'running' ? job.stage : job.state}`));
  box.append(head);
  if (job.state === 'running') {
    const button = make('button', 'Cancel');
    button.type = 'button';
    button.addEventListener('click', () => post(`cancel/${name}`));
    head.append(button);
    const bar = make('progress');
    bar.max = 1;
    bar.value = job.share;
    box.append(bar);
    const left = job.left === null ? '' : `, about ${minutes(job.left)} left`;
    box.append(make('p', `${job.words ? `${job.words}; ` : ''}${minutes(job.elapsed)}${left}`,
      'soft'));
  } else {
    if (job.words && !job.verdict) box.append(make('p', job.words));
    if (!job.verdict) job.lines.forEach((line) => box.append(make('p', line, 'soft')));
  }
  return box;
}

function showVerdict(job) {
  const place = byId('verdict');
  place.hidden = !(job && job.verdict);
  if (place.hidden) return;
  place.className = job.verdict;
  place.replaceChildren(make('p', job.title, 'soft'), make('b', job.words),
    ...job.lines.map((line) => make('p', line)));
}

function showAlarm(alarm) {
  const place = byId('alarm');
  place.hidden = !alarm;
  if (!alarm) return;
  place.className = `${alarm.state}${alarm.offline ? ' offline' : ''}`;
  const lapses = alarm.lapses.slice(-3).map((lapse) => make('p', `▲ ${lapse}`, 'soft'));
  if (alarm.offline) lapses.unshift(make('p', 'ring_alarm: Node offline', 'bad'));
  if (alarm.state === 'blind') {
    place.replaceChildren(make('p', 'Alarm: the ring is not watched', 'soft'),
      make('b', alarm.words),
      ...alarm.missing.map((topic) => make('p', `Missing: ${topic}`)), ...lapses);
    return;
  }
  if (alarm.state !== 'alarm') {
    place.replaceChildren(make('p', `Alarm: ${alarm.words}`, 'soft'), ...lapses);
    return;
  }
  const since = new Date(alarm.since / 1e6).toISOString().replace('T', ' ').replace('Z', ' UTC');
  place.replaceChildren(
    make('p', 'Alarm: the ring has left its model', 'soft'),
    make('b', `${alarm.channel} ${alarm.size}`),
    make('p', `since ${since}, ${alarm.before} s before the alarm`),
    make('p', `First guess: ${alarm.guess}`), ...lapses);
}

function show(state) {
  showAlarm(state.alarm);
  byId('doubt').textContent = state.doubt;
  byId('lost').textContent = (state.missing ? `Not received: ${state.missing}. ` : '')
    + (state.left_out ? `${state.left_out} samples are not drawn: of an earlier test, or not known.` : '');
  showReplay(state.replay);
  showCommands(state.commands);
  showParameters(state.parameters);
  showHealth(state.health);
  const jobs = Object.entries(state.jobs).map(([name, job]) => showJob(name, job));
  renew(byId('jobs').lastElementChild, (jobs.length ? jobs
    : [make('p', 'No goal is running on /identify_ring or /diagnose_ring.', 'soft')]));
  showVerdict(state.jobs.diagnose);
  if (String(state.band) !== String(band)) stale = true;
  band = state.band;
  byId('noise').textContent = band[0] === null ? 'not known yet' : CHANNELS.map(
    (channel) => `${channel.name} ${band[channel.row].toFixed(2)} ${channel.unit}`).join(', ');
}

function link(words, kind) {
  byId('link').textContent = words;
  byId('link').className = kind;
}

function listen() {
  const events = new EventSource('events');
  events.addEventListener('open', () => link('Connected', 'good'));
  events.addEventListener('error', () => {
    link('Server offline; trying again', 'bad');
    if (events.readyState === EventSource.CLOSED) {
      setTimeout(listen, 2000);
    }
  });
  events.addEventListener('rows', (event) => take(JSON.parse(event.data)));
  events.addEventListener('state', (event) => show(JSON.parse(event.data)));
  events.addEventListener('now', (event) => showNow(JSON.parse(event.data)));
}

forget();
for (const name of ['clear', 'zero', 'start', 'pause']) {
  byId(name).addEventListener('click', () => post(name));
}
for (const target of [window, DARK]) {
  for (const event of ['visibilitychange', 'resize', 'change']) {
    target.addEventListener(event, () => { stale = true; });
  }
}
addEventListener('keydown', (event) => {
  if (event.key === 'Enter' && event.target.matches('.modebar-btn')) event.target.click();
});
listen();
draw();
