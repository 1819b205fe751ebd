// The page: what comes in goes to the map and the panel, what is pressed goes out.

import { Link } from './link.js';
import { MapView } from './map.js';
import { Panel, duration, set, span } from './panel.js';

const find = (selector) => document.querySelector(selector);
const SCALE_PX = 120;

const view = new MapView(find('#map'));
const panel = new Panel((stage) => order({ restart: stage }));
let controls = 'off';
let frames = 0;

const link = new Link({
  open() {
    document.body.dataset.link = 'open';
    chip('#link', 'good', 'live');
    find('#notice').hidden = true;
  },
  closed() {
    document.body.dataset.link = 'closed';
    chip('#link', 'bad', 'no connection');
    showNotice('The connection is lost: this is what was last seen. Trying again …');
  },
  frame(json, sections) {
    if (json.hello) greet(json.hello);
    view.take(json, sections);
    panel.take(json);
    if (json.robot) showRobot(json.robot);
    if (json.graph) set(find('#loops'), `${json.graph.accepted} of ${json.graph.searches}`);
    if (json.health !== undefined) showHealth(json.health);
    if (json.catching_up !== undefined) json.catching_up ? showNotice('Reading earlier data …') : (find('#notice').hidden = true);
    view.redraw(() => link.drawn(json.frame));
    frames += 1;
    document.body.dataset.frames = frames;
    document.body.dataset.tiles = view.map.tiles.size + view.live.tiles.size;
  },
});

function greet({ head, controls: given }) {
  controls = given;
  set(find('#robot'), head.robot);
  document.title = `${head.robot} – flockslam`;
  find('#pause').hidden = controls === 'off';
  find('#mode').hidden = controls === 'off';
  find('#save').hidden = !head.can_save || controls === 'off';
  const notes = { open: '', token: 'Orders need the token.', off: 'This page only shows: no token is set for orders.' };
  set(find('#controls-note'), notes[controls]);
}

function chip(selector, kind, text) {
  const made = find(selector);
  made.hidden = false;
  made.className = `chip ${kind}`;
  set(made.querySelector('span'), text);
}

function showNotice(text) {
  set(find('#notice'), text);
  find('#notice').hidden = false;
}

function showRobot(robot) {
  const [x, y, heading] = robot.map_from_base;
  chip('#quality', { tracking: 'good', degraded: 'warn', lost: 'bad' }[robot.quality], robot.quality);
  set(find('#pose-x'), `${x.toFixed(2)} m`);
  set(find('#pose-y'), `${y.toFixed(2)} m`);
  set(find('#pose-h'), `${((heading * 180) / Math.PI).toFixed(1)}°`);
  set(find('#speed'), `${robot.speed_m_s.toFixed(2)} m/s`);
  set(find('#sigma'), robot.sigma_m < 1 ? `${(robot.sigma_m * 1000).toFixed(0)} mm` : `${robot.sigma_m.toFixed(1)} m`);
  set(find('#driven'), robot.length_m < 1000 ? `${robot.length_m.toFixed(0)} m` : `${(robot.length_m / 1000).toFixed(2)} km`);
}

function showHealth(health) {
  if (!health) return chip('#link', 'warn', 'supervisor silent');
  const down = health.stages.filter((stage) => stage.state !== 'running');
  if (health.state === 'degraded') chip('#link', 'bad', 'degraded');
  else if (health.paused) chip('#link', 'warn', 'paused');
  else if (down.length) chip('#link', 'warn', `${down[0].stage} ${down[0].state}`);
  else chip('#link', 'good', 'live');
  const localizes = health.mode.name === 'localize';
  find('#mode').setAttribute('aria-pressed', String(localizes));
  find('#mode').disabled = health.mode.changing;
  set(find('#mode'), localizes ? 'Map on' : 'Localize');
  find('#pause').setAttribute('aria-pressed', String(health.paused));
  set(find('#pause'), health.paused ? 'Go on' : 'Pause');
  const saved = health.saved;
  const words = !saved ? '' : saved.problem ? `Not saved: ${saved.problem}` : saved.age_s == null ? 'The map has not been saved yet.' : `Map saved in ${saved.directory} ${span(saved.age_s)} ago.`;
  set(find('#saved'), words);
}

/** Orders something; asks for the token when one is needed. */
async function order(what) {
  let token = sessionStorage.getItem('token') ?? undefined;
  if (controls === 'token' && !token) token = await askForToken();
  if (controls === 'token' && !token) return;
  const reply = await link.order(what, token);
  if (!reply.ok && controls === 'token') sessionStorage.removeItem('token');
  else if (token) sessionStorage.setItem('token', token);
  toast(reply.text, reply.ok);
}

function askForToken() {
  const dialog = find('#token-dialog');
  find('#token').value = '';
  dialog.returnValue = '';
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener('close', () => resolve(dialog.returnValue === 'ok' ? find('#token').value.trim() : ''), { once: true });
  });
}

let toastTimer;
function toast(text, ok) {
  const made = find('#toast');
  set(made, text);
  made.classList.toggle('bad', !ok);
  made.hidden = false;
  clearTimeout(toastTimer);
  toastTimer = setTimeout(() => (made.hidden = true), 5000);
}

/** A round length of about the width of the scale. */
function showScale() {
  const wanted = SCALE_PX / view.camera.scale;
  const power = 10 ** Math.floor(Math.log10(wanted));
  const metres = [5, 2, 1].map((n) => n * power).find((length) => length <= wanted) ?? power;
  find('#scale-line').style.width = `${metres * view.camera.scale}px`;
  set(find('#scale-text'), metres < 1 ? `${Math.round(metres * 100)} cm` : `${metres} m`);
  const following = String(view.camera.follows);
  if (find('#follow').getAttribute('aria-pressed') !== following) find('#follow').setAttribute('aria-pressed', following);
}
view.onDrawn = showScale;

function togglePanel() {
  const isWide = document.body.classList.toggle('wide-map');
  find('#panel-toggle').setAttribute('aria-expanded', String(!isWide));
}

const { camera } = view;
find('#zoom-in').addEventListener('click', () => camera.zoom(1.4));
find('#zoom-out').addEventListener('click', () => camera.zoom(1 / 1.4));
find('#fit').addEventListener('click', () => camera.fit());
find('#follow').addEventListener('click', () => camera.follow());
find('#panel-toggle').addEventListener('click', togglePanel);
find('#mode').addEventListener('click', () => order({ localize: find('#mode').getAttribute('aria-pressed') !== 'true' }));
find('#pause').addEventListener('click', () => order({ pause: find('#pause').getAttribute('aria-pressed') !== 'true' }));
find('#save').addEventListener('click', () => order('save'));
for (const box of document.querySelectorAll('[data-layer]')) {
  const show = () => {
    view.layers[box.dataset.layer] = box.checked;
    view.redraw();
  };
  box.addEventListener('change', show);
  show();
}
document.addEventListener('keydown', (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches('input, dialog *')) return;
  const keys = { f: () => camera.fit(), r: () => camera.follow(), p: togglePanel };
  keys[event.key.toLowerCase()]?.();
});
document.addEventListener('visibilitychange', () => {
  view.redraw();
  panel.tick();
});

// For tests: what is shown.
export { duration, link, panel, view };
