// Draws what the server says. The server alone knows; a reload or a lost connection starts from it.
'use strict';
const MARKS = { ok: '✓', warning: '▲', error: '✗', silent: '…' };

const byId = (id) => document.getElementById(id);
const make = (tag, text = '', kind = '') => {
  const element = document.createElement(tag);
  element.textContent = text;
  if (kind) element.className = kind;
  return element;
};
const post = (path) => fetch(path, { method: 'POST', headers: { 'X-Saddlering': 'live' } });

const opened = new Set();
let current = null; // the test that runs, or the last one
let past = [];

// A time of day from milliseconds, by the clock of this place.
const clockTime = (milliseconds, digits = 0) => new Date(milliseconds).toLocaleTimeString('en-GB', {
  hour: '2-digit', minute: '2-digit', second: '2-digit', timeZoneName: 'short',
  ...(digits ? { fractionalSecondDigits: digits } : {}) });

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

// The value of a range that is further from zero.
const peakOf = ([low, high]) => (Math.abs(low) > Math.abs(high) ? low : high);

function motionGauge({ name, unit }, row, isOld) {
  const newest = Math.max(...streams.measured.keys());
  const value = streams.measured.get(newest)?.mean[row];
  const peak = current?.peaks.measured[row] ?? [value, value];
  if (value === undefined || value === null) return gauge(name, '–', 'None received');
  return gauge(name, `${value.toFixed(1)} ${unit}`, `peak ${peakOf(peak).toFixed(1)} ${unit}`,
    'ok', isOld);
}

function showNow(now) {
  const { load, elevation, probes } = now.gauges;
  current = now.test;
  const began = current ? ` since ${clockTime(current.began)}` : '';
  byId('test').textContent = (current?.name ? `Test ${current.name}` : 'Test in progress') + began
    + (now.ended ? `: test ended ${clockTime(now.ended)}, last values` : '');
  const peak = current?.peaks.load[0][1];
  document.querySelector('#now .gauges').replaceChildren(
    gauge('Load', load ? loadWords(load, rig.unit) : '–', load ? `peak ${peak?.toFixed(2)} ${rig.unit}; `
      + loadWords(load, rig.unit === 't' ? 'kN' : 't') : 'None received', 'ok', load?.is_old),
    ...CHANNELS.map((channel, row) => motionGauge(channel, row, load?.is_old)),
    gauge('Elevation', elevation ? `${elevation.deg}°` : '–',
      elevation ? (elevation.is_measured ? 'measured' : 'as simulated') : 'None received',
      'ok', elevation?.is_old || now.ended),
    ...probes.map((probe, i) => probeGauge(probe, i + 1)));
  showTests();
}

function testRow(test) {
  const isShown = earlier ? earlier.number === test.number : test === current;
  const row = make('tr');
  const button = make('button', clockTime(test.began));
  button.type = 'button';
  button.title = 'Show the curves of this test';
  button.addEventListener('click', () => (test === current ? returnToNow() : lookAt(test.number)));
  const { level, words } = test.verdict;
  const cells = [button, test.name || 'no name', make('span', `${MARKS[level]} ${words}`, level),
    `${test.seconds.toFixed(1)} s`,
    test.peaks.load[0][1]?.toFixed(2) ?? '–',
    ...test.peaks.measured.slice(0, 3).map((range) => (range[0] === null ? '–' : peakOf(range).toFixed(1)))];
  row.append(...cells.map((cell) => {
    const place = make('td');
    place.append(cell);
    return place;
  }));
  if (isShown) row.setAttribute('aria-current', 'true');
  return row;
}

function showTests() {
  const tests = [...past, current].filter(Boolean).reverse();
  const head = make('tr');
  head.append(...['began', 'test', 'alarm', 'time', `peak load / ${rig.unit}`,
    ...CHANNELS.map(({ name, unit }) => `${name} / ${unit}`)].map((it) => make('th', it)));
  renew(byId('tests'), tests.length ? [head, ...tests.map(testRow)]
    : [make('caption', 'None yet', 'soft')]);
  const shown = tests.find((test) => test.number === earlier?.number) ?? current;
  byId('shown').textContent = shown ? `Curves of ${shown.name || 'the test'}, `
    + `${new Date(shown.began).toLocaleDateString('en-CA')} ${clockTime(shown.began)}: `
    + shown.verdict.words : 'Curves';
  byId('bag').hidden = !shown?.has_bag;
  if (shown) byId('bag').href = `bags/${shown.number}`;
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
  const [short, rest] = parameters.source.split(' (', 2);
  byId('source').textContent = short;
  byId('notes').textContent = rest ? rest.slice(0, -1) : '';
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
    const told = items.filter((item, i) => items.findIndex((it) => it.words === item.words) === i);
    return items.length ? node(`probe ${number}`, items, told) : null;
  }).filter(Boolean);
  const parity = health.filter((item) => item.name.endsWith('ring_displacement: parity'));
  if (parity.length) probes.push(node('parity of probes 1 and 3', parity, parity));
  byId('probes').replaceChildren(...(probes.length ? probes
    : [make('p', 'ring_displacement: Node offline', 'soft')]));
  const names = [...new Set(health.map((item) => item.name.split(':')[0]))];
  const { words } = health[0] || {};
  if (health.length && health.every((item) => item.level === 'silent' && item.words === words)) {
    byId('probes').replaceChildren(make('p', `All nodes: ${words}`, 'soft'));
    renew(byId('nodes'), [node(`${words}: ${names.join(', ')}`, health, [])]);
    return;
  }
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
  if (alarm.offline) {
    lapses.unshift(make('p', `ring_alarm: ${alarm.offline}`,
      alarm.offline === 'Node offline' ? 'bad' : 'soft'));
  }
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
  place.replaceChildren(
    make('p', 'Alarm: the ring has left its model', 'soft'),
    make('b', `${alarm.channel} ${alarm.size}`),
    make('p', `since ${clockTime(alarm.since / 1e6, 3)}, ${alarm.before} s before the alarm`),
    make('p', `First guess: ${alarm.guess}.${alarm.why ? ` Reason: ${alarm.why}.` : ''}`),
    ...alarm.taken_back.map(([guess, seconds]) => {
      const line = make('p', `Taken back ${seconds} s after the alarm, because later samples speak against it: `, 'soft');
      line.append(make('s', guess));
      return line;
    }), ...lapses);
}

const listed = (values) => (values[0] === null ? 'not known yet' : CHANNELS.map(
  ({ name, unit }, row) => `${name} ${values[row]?.toFixed(2) ?? '–'} ${unit}`).join(', '));

function show(state) {
  const known = { fullLoad: state.full_load, unit: state.force_unit, range: state.range,
    allowed: state.allowed, band: state.band };
  if (JSON.stringify(known) !== JSON.stringify(rig)) stale = true;
  rig = known;
  past = state.past;
  showAlarm(state.alarm);
  byId('doubt').textContent = state.doubt;
  byId('lost').textContent = (state.missing ? `Not received: ${state.missing}. ` : '')
    + (state.left_out ? `${state.left_out} samples are not drawn: of an earlier test, or not known.` : '');
  showReplay(state.replay);
  showCommands(state.commands);
  showParameters(state.parameters);
  showHealth(state.health);
  showTests();
  const jobs = Object.entries(state.jobs).map(([name, job]) => showJob(name, job));
  renew(byId('jobs').lastElementChild, (jobs.length ? jobs
    : [make('p', 'No goal is running on /identify_ring or /diagnose_ring.', 'soft')]));
  showVerdict(state.jobs.diagnose);
  byId('noise').textContent = listed(state.band);
  byId('allowed').textContent = listed(state.allowed);
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

for (const name of ['clear', 'zero', 'start', 'pause']) {
  byId(name).addEventListener('click', () => post(name));
}
byId('back').addEventListener('click', returnToNow);
byId('picture').addEventListener('click', savePicture);
byId('follow').addEventListener('change', returnToNow);
for (const target of [window, document, DARK]) {
  for (const event of ['visibilitychange', 'resize', 'change']) {
    target.addEventListener(event, () => { stale = true; });
  }
}
setInterval(() => { byId('clock').textContent = clockTime(Date.now()); }, 1000);
listen();
draw();
