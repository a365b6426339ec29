// What the page's buttons, slider, keys and table do.

const find = (name) => document.getElementById(name);
const record = new Record(JSON.parse(find("content").textContent));
const state = { mode: "error", step: record.last, vertex: null, sliced: true, same: false };
const MOST_ROWS = 100; // of the table
const PAPER = 680; // pixels across a printed sheet
const PAUSE = 700; // milliseconds a step, while playing
let space = null;
let playing = null;

function make(name, text, parent, style = "") {
  const element = document.createElement(name);
  element.textContent = text;
  element.className = style;
  parent.append(element);
  return element;
}

const several = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;

function update() {
  const supports = record.supports(state.step);
  const top = record.top(state.same ? undefined : state.step);
  space?.show({ ...state, top });
  drawLegend(top);
  tellStep(supports);
  tellSupports(supports);
  tellChosen(supports);
}

function drawLegend(top) {
  find("legend").hidden = state.mode !== "error";
  const bar = find("ticks");
  bar.replaceChildren();
  for (const value of ticks(0, top, 4)) make("span", shown(value), bar).style.left = `${(100 * value) / top}%`;
  find("sliced").hidden = state.mode === "target";
  find("shared").hidden = state.mode !== "error";
}

function tellStep(supports) {
  const said = record.steps[state.step];
  const special = state.step === record.last ? ", result" : state.step === record.before ? ", before rounding" : "";
  const where = `step ${said.step} of ${record.total - 1}${special}`;
  find("step").value = state.step;
  find("step").setAttribute("aria-valuetext", `${where}, ${several(supports.length, "support")}`);
  find("place").textContent = where;
  const { distance } = record.shape(state.step);
  const figures = [
    several(supports.length, "support"),
    `rms distance ${shown(record.rms(distance), 3)} m`,
    `objective ${shown(said.objective, 5)}`,
    `stationarity ${shown(said.stationarity, 2)}`,
    `${shown(said.seconds, 2)} s`,
  ];
  const note = find("note");
  note.replaceChildren();
  make("span", said.note, note, "said");
  make("span", figures.join(", "), note);
  make("span", changes(supports), note);
}

// Which supports came and went since the step before.
function changes(supports) {
  if (state.step === 0) return "";
  const [now, then] = [supports, record.supports(state.step - 1)].map((list) => new Set(list.map((one) => one.vertex)));
  const tell = (word, found) => {
    if (!found.length) return [];
    return [found.length > 6 ? `${found.length} ${word}` : `${word}: ${found.join(", ")}`];
  };
  const told = [...tell("new", [...now].filter((v) => !then.has(v))), ...tell("gone", [...then].filter((v) => !now.has(v)))];
  return told.length ? told.join("; ") : "same supports as before";
}

function tellSupports(supports) {
  find("count").textContent = several(supports.length, "support");
  const kinds = find("kinds");
  kinds.replaceChildren();
  for (const kind of Object.keys(record.kinds)) {
    const count = supports.filter((one) => one.kind === kind).length;
    if (count) make("span", "", make("li", several(count, kind), kinds), `swatch ${kind}`);
  }
  if (record.held.length + record.points.length) make("span", "", make("li", "fixed", kinds), "swatch held");
  if (record.cables.length) make("span", "", make("li", "cable", kinds), "swatch cable");
  const body = find("supports");
  const focused = body.contains(document.activeElement) ? document.activeElement.textContent : null;
  body.replaceChildren();
  const largest = [...supports].sort((one, other) => other.magnitude - one.magnitude).slice(0, MOST_ROWS);
  const listed = supports.length > MOST_ROWS ? largest.sort((one, other) => one.vertex - other.vertex) : supports;
  for (const one of listed) {
    const row = make("tr", "", body);
    const button = make("button", String(one.vertex), make("td", "", row));
    button.type = "button";
    button.setAttribute("aria-pressed", String(one.vertex === state.vertex));
    button.setAttribute("aria-label", `figures of the ${one.kind} at vertex ${one.vertex}`);
    make("td", one.kind, row);
    for (const text of [shown(one.magnitude), shown(one.length), `${one.lean.toFixed(1)}\u00b0`]) make("td", text, row, "number");
    row.addEventListener("click", () => choose(one.vertex));
    if (button.textContent === focused) button.focus();
  }
  find("scroll").hidden = !supports.length;
  const left = supports.length - listed.length;
  find("more").textContent = left > 0 ? `and ${left} smaller; a click on one of them shows its figures` : "";
}

function tellChosen(supports) {
  const panel = find("chosen");
  panel.replaceChildren();
  panel.hidden = state.vertex === null;
  if (state.vertex === null) return;
  const close = make("button", "\u00d7", panel, "close");
  close.type = "button";
  close.setAttribute("aria-label", "let go of the support");
  close.addEventListener("click", () => choose(null));
  const one = supports.find((support) => support.vertex === state.vertex);
  if (!one) {
    make("p", `Vertex ${state.vertex}: no support at this step.`, panel);
    return;
  }
  make("h2", `${one.kind} at vertex ${one.vertex}`, panel);
  const list = make("dl", "", panel);
  // what is far below the whole force is round-off
  const parts = one.force.map((value) => shown(Math.abs(value) < 1e-6 * one.magnitude ? 0 : value));
  const tell = (name, text) => {
    make("dt", name, list);
    make("dd", text, list);
  };
  tell("force", `${shown(one.magnitude)} N (${parts.join(", ")})`);
  tell("length", one.length === null ? "none: it has no foot" : `${shown(one.length)} m`);
  tell("lean", `${one.lean.toFixed(1)}\u00b0 from upright`);
  tell("head", record.place(one.head));
  if (one.foot) tell("foot", `${record.place(one.foot)}${one.whole ? "" : ", outside the picture"}`);
}

function set(change) {
  Object.assign(state, change);
  update();
}

const choose = (vertex) => set({ vertex });
const go = (step) => set({ step: Math.max(0, Math.min(record.last, step)) });

function setMode(mode) {
  document.querySelector(`input[value=${mode}]`).checked = true;
  set({ mode });
}

function stop() {
  clearInterval(playing);
  playing = null;
  find("play").textContent = "\u25b6";
  find("play").setAttribute("aria-label", "play the run");
}

function play() {
  if (playing !== null) return stop();
  if (state.step === record.last) go(0);
  find("play").textContent = "\u275a\u275a";
  find("play").setAttribute("aria-label", "stop");
  playing = setInterval(() => (state.step < record.last ? go(state.step + 1) : stop()), PAUSE);
}

function press(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const turn = { ArrowLeft: [-10, 0], ArrowRight: [10, 0], ArrowUp: [0, 10], ArrowDown: [0, -10] }[event.key];
  const plain = event.target === document.body || event.target === find("canvas");
  const does = {
    1: () => setMode("target"),
    2: () => setMode("membrane"),
    3: () => setMode("error"),
    r: () => look(),
    p: () => look(-90, 89.9),
    Escape: () => choose(null),
    // buttons and the modes have these keys for themselves
    ...(plain ? { " ": play, ArrowLeft: () => go(state.step - 1), ArrowRight: () => go(state.step + 1) } : {}),
  };
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const act = event.shiftKey && turn ? () => space?.turn(...turn) : does[key];
  if (!act) return;
  act();
  event.preventDefault();
}

function look(azimuth, elevation) {
  if (!space) return;
  space.frame(azimuth, elevation);
  space.moved = azimuth !== undefined;
}

// What stands after # in the address: mode, step and vertex, as in view.html#mode=membrane&step=3&vertex=181.
function readAddress() {
  const asked = new URLSearchParams(location.hash.slice(1));
  if (["target", "membrane", "error"].includes(asked.get("mode"))) state.mode = asked.get("mode");
  if (/^\d+$/.test(asked.get("step") ?? "")) state.step = Math.min(record.last, Number(asked.get("step")));
  if (/^\d+$/.test(asked.get("vertex") ?? "")) state.vertex = Number(asked.get("vertex"));
  setMode(state.mode);
}

function listen() {
  for (const radio of document.querySelectorAll("input[name=mode]")) radio.addEventListener("change", () => setMode(radio.value));
  find("slices").addEventListener("change", (event) => set({ sliced: event.target.checked }));
  find("same").addEventListener("change", (event) => set({ same: event.target.checked }));
  find("step").addEventListener("input", (event) => {
    stop();
    go(Number(event.target.value));
  });
  find("play").addEventListener("click", play);
  find("reset").addEventListener("click", () => look());
  find("plan").addEventListener("click", () => look(-90, 89.9));
  document.addEventListener("keydown", press);
  window.addEventListener("hashchange", readAddress);
  const canvas = find("canvas");
  let down = null;
  canvas.addEventListener("pointerdown", (event) => (down = event));
  canvas.addEventListener("click", (event) => {
    // a drag ends with a click too; fingers are less exact than a mouse
    if (!down || Math.hypot(event.clientX - down.clientX, event.clientY - down.clientY) > 5) return;
    const box = canvas.getBoundingClientRect();
    choose(space.pick(event.clientX - box.left, event.clientY - box.top, down.pointerType === "touch" ? 22 : 10));
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    space?.paint(getComputedStyle(document.body));
    update();
  });
  // on paper the picture keeps the shape that it has on the screen, and the numbers their places
  window.addEventListener("beforeprint", () => {
    const { style, clientWidth: width, clientHeight: height } = find("space");
    Object.assign(style, { width: `${width}px`, height: `${height}px`, zoom: Math.min(1, PAPER / width) });
  });
  window.addEventListener("afterprint", () => find("space").removeAttribute("style"));
}

function begin() {
  const held = record.steps.length;
  const thin = held < record.total ? `The run was long: the page holds ${held} of its ${record.total} steps.` : "";
  find("canvas").setAttribute("aria-label", `Membrane with ${several(record.supports(record.last).length, "support")}`);
  find("step").max = record.last;
  find("run").hidden = record.last === 0; // a shape that was asked for, not searched
  find("thin").textContent = thin;
  const shades = [...Array(17).keys()].map((i) => record.colours.subarray(3 * Math.min(255, 16 * i)).slice(0, 3));
  find("bar").style.background = `linear-gradient(to right, ${shades.map((rgb) => `rgb(${rgb.join(",")})`).join(",")})`;
  try {
    space = new Space(find("canvas"), find("labels"), record);
    space.paint(getComputedStyle(document.body));
  } catch (error) {
    find("notice").textContent =
      `This browser draws no WebGL (${error.message}), so the picture is missing. ` +
      "Supports and steps are told here all the same; picture.png shows the result.";
    for (const name of ["canvas", "shown", "views"]) find(name).hidden = true;
    find("notice").hidden = false;
  }
  listen();
  readAddress();
}

begin();
