"use strict";
// Three-dimensional view of a scan: WebGL 2, no library. Reads the JSON of <script id="scene"> (contour/web_scene.py),
// lengths in mm about the middle of the scan. State for tests: <html data-viewer="ready" data-viewer-covered="0.31">.
(() => {
  const page = document.documentElement;
  const box = document.getElementById("viewer");
  if (!box) return;
  const fail = (what) => {
    page.dataset.viewer = "failed: " + what;
    const note = document.getElementById("viewer-failed");
    note.hidden = false;
    note.textContent = "The 3-D view cannot be shown: " + what + ". Everything else on this page stands.";
    box.hidden = true;
  };
  window.addEventListener("error", (event) => fail(event.message));
  const $ = (id) => document.getElementById(id);

  // ------------------------------------------------------------------------------------------------ data
  const KINDS = { i1: Int8Array, u1: Uint8Array, i2: Int16Array, u2: Uint16Array, i4: Int32Array, u4: Uint32Array,
                  f4: Float32Array };
  const decode = (packed) => {
    const text = atob(packed.data), bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    const raw = new KINDS[packed.type](bytes.buffer);
    if (packed.scale === undefined) return raw;
    const values = new Float32Array(raw.length);
    for (let i = 0; i < raw.length; i++) values[i] = raw[i] * packed.scale;
    return values;
  };
  const scene = JSON.parse($("scene").textContent);
  const contacts = Object.fromEntries(Object.entries(scene.contacts.columns).map(([k, v]) => [k, decode(v)]));
  const count = scene.contacts.count, segments = decode(scene.segments);
  const surface = scene.surface && {
    position: decode(scene.surface.position), normal: decode(scene.surface.normal), index: decode(scene.surface.index),
    fields: scene.surface.fields.map((field) => ({ ...field, values: decode(field.values) })),
    touched: decode(scene.surface.touched),
  };

  // ---------------------------------------------------------------------------------------------- colours
  const MAPS = {
    diverging: [[33, 79, 158], [110, 158, 213], [235, 235, 235], [235, 150, 110], [170, 30, 45]],
    sequential: [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]],
  };
  const CATEGORIES = [[0, 114, 178], [213, 94, 0], [0, 158, 115], [204, 121, 167], [240, 228, 66]];
  const GREY = [168, 168, 168], PLAIN = [196, 190, 178], ORANGE = [230, 120, 0], RED = [214, 30, 30];
  const mix = (map, t) => {
    const stops = MAPS[map], x = Math.min(Math.max(t, 0), 1) * (stops.length - 1);
    const i = Math.min(Math.floor(x), stops.length - 2), f = x - i;
    return stops[i].map((c, k) => Math.round(c + f * (stops[i + 1][k] - c)));
  };
  const css = (colour) => `rgb(${colour.join(",")})`;
  const ramp = (map) => {
    const stops = MAPS[map].map((c, i, all) => `${css(c)} ${(100 * i) / (all.length - 1)}%`);
    return `linear-gradient(to right, ${stops.join(", ")})`;
  };
  const number = (value) => (Math.abs(value) >= 100 ? value.toFixed(0) : String(Number(value.toPrecision(3))));

  // ------------------------------------------------------------------------------------------------- WebGL
  const canvas = $("canvas");
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, preserveDrawingBuffer: true });
  if (!gl) return fail("this browser offers no WebGL 2");
  const SHADERS = {
    surface: [`#version 300 es
      in vec3 position; in vec3 normal; in vec4 colour;
      uniform mat4 view, projection; out vec3 n, at, seen; out vec4 c;
      void main() { at = position; c = colour; n = mat3(view) * normal;
        vec4 p = view * vec4(position, 1.0); seen = p.xyz; gl_Position = projection * p; }`,
    `#version 300 es
      precision highp float; in vec3 n, at, seen; in vec4 c; uniform vec4 cut; uniform float stripe; out vec4 pixel;
      void main() { if (dot(cut.xyz, at) > cut.w) discard;
        vec3 m = normalize(n); if (!gl_FrontFacing) m = -m;
        float lit = 0.42 + 0.50 * max(dot(m, normalize(vec3(0.25, 0.45, 1.0))), 0.0)
                         + 0.14 * max(dot(m, normalize(vec3(-0.8, -0.2, 0.4))), 0.0);
        vec3 own = c.a > 0.5 ? c.rgb : c.rgb * (fract((gl_FragCoord.x + gl_FragCoord.y) / stripe) < 0.5 ? 0.62 : 0.80);
        vec3 base = gl_FrontFacing ? own : mix(own, vec3(0.35, 0.35, 0.40), 0.75);
        pixel = vec4(base * lit, 1.0); }`],
    points: [`#version 300 es
      in vec3 position; in vec4 colour; uniform mat4 view, projection; uniform float size, lift; out vec4 c;
      void main() { c = colour; vec4 p = view * vec4(position, 1.0); p.xyz *= 1.0 - lift / length(p.xyz);
        gl_Position = projection * p; gl_PointSize = size; }`,
    `#version 300 es
      precision highp float; in vec4 c; uniform float ring; out vec4 pixel;
      void main() { vec2 d = 2.0 * gl_PointCoord - 1.0; float r = dot(d, d);
        if (r > 1.0 || (ring > 0.0 && r < 0.45)) discard;
        pixel = vec4(ring > 0.0 || r < 0.55 ? c.rgb : c.rgb * 0.55, 1.0); }`],
    lines: [`#version 300 es
      in vec2 corner; in vec3 a, b; in vec4 colourA, colourB;
      uniform mat4 view, projection; uniform vec2 window; uniform float width, lift; out vec4 c;
      vec4 place(vec3 x) { vec4 p = view * vec4(x, 1.0); p.xyz *= 1.0 - lift / length(p.xyz); return projection * p; }
      void main() { vec4 p = place(a), q = place(b);
        vec2 way = (q.xy / q.w - p.xy / p.w) * window; float l = length(way);
        vec2 side = l > 1e-6 ? vec2(-way.y, way.x) / l : vec2(0.0, 1.0);
        vec4 end = corner.x < 0.5 ? p : q; c = corner.x < 0.5 ? colourA : colourB;
        end.xy += side * corner.y * width / window * end.w; gl_Position = end; }`,
    `#version 300 es
      precision highp float; in vec4 c; out vec4 pixel; void main() { pixel = vec4(c.rgb, 1.0); }`],
  };
  const program = ([vertex, fragment]) => {
    const made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost())
        throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost())
      throw new Error(gl.getProgramInfoLog(made));
    return made;
  };
  let programs, buffers;
  const TYPES = new Map([[Int8Array, 0x1400], [Uint8Array, 0x1401], [Int16Array, 0x1402], [Uint16Array, 0x1403],
                         [Uint32Array, 0x1405], [Float32Array, 0x1406]]);
  const upload = (name, data, target = gl.ARRAY_BUFFER) => {
    buffers[name] ??= { buffer: gl.createBuffer() };
    buffers[name].type = TYPES.get(data.constructor);
    gl.bindVertexArray(null);
    gl.bindBuffer(target, buffers[name].buffer);
    gl.bufferData(target, data, gl.STATIC_DRAW);
  };
  const attribute = (of, name, from, size, { normalised = false, divisor = 0, stride = 0, offset = 0 } = {}) => {
    const place = gl.getAttribLocation(of, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[from].buffer);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, buffers[from].type, normalised, stride, offset);
    gl.vertexAttribDivisor(place, divisor);
  };

  // ---------------------------------------------------------------------------------------------- geometry
  const R = scene.radius;
  const normalLength = 0.05 * R;
  const rgba = (colours) => {
    const out = new Uint8Array(4 * colours.length);
    colours.forEach((c, i) => out.set([...c, 255], 4 * i));
    return out;
  };
  const lineEnds = () => {
    const ends = new Float32Array(3 * segments.length);
    segments.forEach((row, i) => ends.set(contacts.position.subarray(3 * row, 3 * row + 3), 3 * i));
    return ends;
  };
  const normalEnds = () => {
    const ends = new Float32Array(6 * count);
    for (let i = 0; i < count; i++)
      for (let k = 0; k < 3; k++) {
        ends[6 * i + k] = contacts.position[3 * i + k];
        ends[6 * i + 3 + k] = contacts.position[3 * i + k] + (normalLength * contacts.normal[3 * i + k]) / 127;
      }
    return ends;
  };
  const setup = () => {
    programs = Object.fromEntries(Object.entries(SHADERS).map(([name, both]) => [name, program(both)]));
    buffers = {};
    upload("corner", new Float32Array([0, -1, 0, 1, 1, -1, 1, 1]));
    upload("contact", contacts.position);
    upload("line", lineEnds());
    upload("normal", normalEnds());
    if (surface) {
      upload("vertex", surface.position);
      upload("vertexNormal", surface.normal);
      gl.bindVertexArray(null);
      upload("index", surface.index, gl.ELEMENT_ARRAY_BUFFER);
    }
    colourSurface();
    colourContacts();
  };

  // ------------------------------------------------------------------------------------------ what is shown
  const bad = (i) => contacts.flags[i] !== 0;
  const wrong = (i) => contacts.wrong !== undefined && contacts.wrong[i] !== 0;
  const shownField = () => surface && surface.fields.find((f) => f.name === $("surface-colour").value);
  function colourSurface() {
    if (!surface) return;
    const field = shownField(), legend = $("surface-legend");
    const vertices = surface.touched.length, colours = new Uint8Array(4 * vertices).fill(255);
    const range = field ? Number($("range").value) : 1;
    for (let i = 0; i < vertices; i++) {
      let c = PLAIN;
      if (field) {
        const t = field.values[i] / range;
        c = mix(field.map, field.map === "diverging" ? 0.5 + 0.5 * t : t);
      }
      const guess = !surface.touched[i] && !(field && field.name === "trust");
      colours.set(guess ? [...GREY, 0] : c, 4 * i); // alpha 0: stripes
    }
    upload("vertexColour", colours);
    const low = field && field.map === "diverging" ? -range : 0;
    legend.querySelector(".title").textContent = field ? field.label : "Surface";
    legend.querySelector(".bar").hidden = !field;
    legend.querySelector(".ends").hidden = !field;
    if (field) {
      legend.querySelector(".bar").style.background = ramp(field.map);
      const ends = legend.querySelectorAll(".ends span");
      ends[0].textContent = low < 0 ? "\u2264 \u2212" + number(range) : "0";
      ends[1].textContent = low < 0 ? "0" : number(range / 2);
      ends[2].textContent = "\u2265 " + (low < 0 ? "+" : "") + number(range);
    }
    const said = legend.querySelector(".said"), marks = legend.querySelectorAll(".bar i");
    said.hidden = !(field && field.said);
    said.textContent = (field && field.said) || "";
    marks.forEach((mark, k) => {
      mark.hidden = !(field && field.marks && field.marks < range);
      if (!mark.hidden) mark.style.left = 50 + (k ? 50 : -50) * (field.marks / range) + "%";
    });
    legend.querySelector(".note").hidden = Boolean(field && field.name === "trust");
    $("range-label").hidden = !field;
  }
  let contactColours = [];
  function colourContacts() {
    const shade = scene.contacts.shades.find((s) => s.name === $("contact-colour").value);
    const legend = $("contact-legend"), values = contacts[shade.column];
    contactColours = Array.from({ length: count }, (_, i) =>
      shade.words ? CATEGORIES[values[i]] : mix("sequential", (values[i] * (shade.factor ?? 1)) / shade.range));
    const points = contactColours.map((c, i) => (bad(i) ? ORANGE : wrong(i) ? RED : c));
    upload("contactColour", rgba(points));
    upload("lineColour", rgba(Array.from(segments, (row) => contactColours[row])));
    upload("normalColour", rgba(points.flatMap((c) => [c, c])));
    legend.querySelector(".title").textContent = shade.label;
    const bar = legend.querySelector(".bar"), ends = legend.querySelector(".ends"), words = legend.querySelector(".words");
    bar.hidden = ends.hidden = Boolean(shade.words);
    words.hidden = !shade.words;
    words.replaceChildren(...(shade.words ?? []).map((word, k) => {
      const item = document.createElement("span"), swatch = document.createElement("i");
      swatch.style.background = css(CATEGORIES[k]);
      item.append(swatch, word);
      return item;
    }));
    bar.style.background = ramp("sequential");
    const texts = ["0", number(shade.range / 2), (shade.open ? "\u2265 " : "") + number(shade.range)];
    ends.querySelectorAll("span").forEach((span, k) => (span.textContent = texts[k]));
  }

  // ------------------------------------------------------------------------------------------------ camera
  const FIELD = (30 * Math.PI) / 180;
  const HOME = { azimuth: -0.9, elevation: 0.42 };
  const camera = { ...HOME, distance: 0, target: [0, 0, 0] };
  const wide = () => (1.06 * R) / Math.sin(FIELD / 2) / Math.min(1, canvas.clientWidth / canvas.clientHeight || 1);
  const axes = () => {
    const [ca, sa, ce, se] = [Math.cos(camera.azimuth), Math.sin(camera.azimuth), Math.cos(camera.elevation),
                              Math.sin(camera.elevation)];
    return { right: [-sa, ca, 0], up: [-se * ca, -se * sa, ce], back: [ce * ca, ce * sa, se] };
  };
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const matrices = () => {
    const { right, up, back } = axes(), t = camera.target, d = camera.distance;
    const view = [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
                  -dot(right, t), -dot(up, t), -dot(back, t) - d, 1];
    const reach = 1.1 * Math.max(R, scene.reach) + Math.hypot(...t), near = Math.max(d - reach, 0.01 * R), far = d + reach;
    const f = 1 / Math.tan(FIELD / 2), aspect = canvas.width / canvas.height;
    const projection = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0,
                        (2 * far * near) / (near - far), 0];
    return { view, projection };
  };
  const project = (i, { view, projection }) => {
    const p = contacts.position, q = [p[3 * i], p[3 * i + 1], p[3 * i + 2]];
    const e = [0, 1, 2].map((k) => view[k] * q[0] + view[4 + k] * q[1] + view[8 + k] * q[2] + view[12 + k]);
    return { x: (0.5 + (0.5 * projection[0] * e[0]) / -e[2]) * canvas.clientWidth,
             y: (0.5 - (0.5 * projection[5] * e[1]) / -e[2]) * canvas.clientHeight, depth: -e[2] };
  };

  // ----------------------------------------------------------------------------------------------- drawing
  let chosen = -1, waiting = false;
  const use = (name, { view, projection }) => {
    const p = programs[name];
    gl.useProgram(p);
    gl.uniformMatrix4fv(gl.getUniformLocation(p, "view"), false, view);
    gl.uniformMatrix4fv(gl.getUniformLocation(p, "projection"), false, projection);
    return { p, set: (what, ...v) => gl["uniform" + v.length + "f"](gl.getUniformLocation(p, what), ...v) };
  };
  const drawLines = (seen, ends, colours, pieces, width, lift) => {
    if (!pieces) return;
    const { p, set } = use("lines", seen);
    set("window", canvas.width, canvas.height);
    set("width", width);
    set("lift", lift);
    attribute(p, "corner", "corner", 2);
    attribute(p, "a", ends, 3, { divisor: 1, stride: 24 });
    attribute(p, "b", ends, 3, { divisor: 1, stride: 24, offset: 12 });
    attribute(p, "colourA", colours, 4, { normalised: true, divisor: 1, stride: 8 });
    attribute(p, "colourB", colours, 4, { normalised: true, divisor: 1, stride: 8, offset: 4 });
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, pieces);
  };
  const drawPoints = (seen, size, { lift, ring = 0, first = 0, pieces = count, colour = null }) => {
    const { p, set } = use("points", seen);
    set("size", size);
    set("lift", lift);
    set("ring", ring);
    attribute(p, "position", "contact", 3);
    attribute(p, "colour", "contactColour", 4, { normalised: true });
    if (colour) {
      gl.disableVertexAttribArray(gl.getAttribLocation(p, "colour"));
      gl.vertexAttrib4f(gl.getAttribLocation(p, "colour"), ...colour, 1);
    }
    gl.drawArrays(gl.POINTS, first, pieces);
  };
  const cutPlane = () => {
    const axis = ["x", "y", "z"].indexOf($("cut").value), where = (Number($("cut-at").value) / 100) * 2 - 1;
    $("cut-at").disabled = axis < 0;
    if (axis < 0) return [0, 0, 0, 1];
    return [0, 1, 2].map((k) => (k === axis ? 1 : 0)).concat(1.02 * where * scene.half[axis]);
  };
  function draw() {
    waiting = false;
    if (gl.isContextLost()) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [w, h] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (!w || !h) return;
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    if (!camera.distance) camera.distance = wide();
    gl.viewport(0, 0, w, h);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.bindVertexArray(null);
    for (let i = 0; i < 8; i++) { gl.disableVertexAttribArray(i); gl.vertexAttribDivisor(i, 0); }
    const seen = matrices(), lift = 0.012 * R;
    if (surface && $("show-surface").checked) {
      const { p, set } = use("surface", seen);
      set("cut", ...cutPlane());
      set("stripe", 9 * ratio);
      attribute(p, "position", "vertex", 3);
      attribute(p, "normal", "vertexNormal", 3, { normalised: true });
      attribute(p, "colour", "vertexColour", 4, { normalised: true });
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.index.buffer);
      gl.drawElements(gl.TRIANGLES, surface.index.length, buffers.index.type, 0);
      for (let i = 0; i < 8; i++) gl.disableVertexAttribArray(i);
    }
    if ($("show-contours").checked) drawLines(seen, "line", "lineColour", segments.length / 2, 1.1 * ratio, lift);
    if ($("show-normals").checked) drawLines(seen, "normal", "normalColour", count, 0.6 * ratio, lift);
    for (let i = 0; i < 8; i++) { gl.disableVertexAttribArray(i); gl.vertexAttribDivisor(i, 0); }
    const size = Math.max(2.5, Math.min(9, (4.0 * wide()) / camera.distance)) * ratio;
    if ($("show-points").checked) drawPoints(seen, size, { lift });
    if ($("show-marked").checked)
      for (const i of marked)
        drawPoints(seen, size + 7 * ratio, { lift: 1.5 * lift, ring: 1, first: i, pieces: 1 });
    if (chosen >= 0) {
      gl.disable(gl.DEPTH_TEST);
      drawPoints(seen, 22 * ratio, { lift, ring: 1, first: chosen, pieces: 1, colour: [1.0, 0.0, 0.75] });
    }
    furniture();
  }
  const marked = [];
  for (let i = 0; i < count; i++) if (bad(i) || wrong(i)) marked.push(i);
  const redraw = () => { if (!waiting) { waiting = true; requestAnimationFrame(draw); } };
  function furniture() {
    const { right, up } = axes();
    "xyz".split("").forEach((name, k) => {
      const [x, y] = [26 * right[k], -26 * up[k]], line = $("axis-" + name), text = $("axis-name-" + name);
      line.setAttribute("x2", x);
      line.setAttribute("y2", y);
      text.setAttribute("x", 1.32 * x);
      text.setAttribute("y", 1.32 * y + 4);
    });
    const perPixel = (2 * camera.distance * Math.tan(FIELD / 2)) / canvas.clientHeight;
    const want = 110 * perPixel, power = 10 ** Math.floor(Math.log10(want));
    const length = [5, 2, 1].map((k) => k * power).find((l) => l <= want);
    $("scale-bar").style.width = length / perPixel + "px";
    $("scale-text").textContent = number(length) + " mm";
  }

  // ---------------------------------------------------------------------------------------------- choosing
  const flagWords = (bits) => scene.contacts.flags.filter((f) => bits & f.bit).map((f) => f.word).join(", ");
  const choose = (i) => {
    chosen = i;
    const list = $("chosen");
    list.hidden = i < 0;
    if (i >= 0) {
      const rows = [["contact", String(contacts.id[i])]];
      for (const item of scene.contacts.readout) {
        const value = contacts[item.column][i] * (item.factor ?? 1);
        rows.push([item.label, item.words ? item.words[value] : value.toFixed(item.digits) + " " + item.unit]);
      }
      if (bad(i)) rows.push(["flags", flagWords(contacts.flags[i])]);
      if (wrong(i)) rows.push(["note", "silently wrong"]);
      list.replaceChildren(...rows.flatMap(([name, value]) => {
        const term = document.createElement("dt"), what = document.createElement("dd");
        term.textContent = name;
        what.textContent = value;
        return [term, what];
      }));
    }
    redraw();
  };
  const pick = (x, y) => {
    const seen = matrices();
    let best = -1, nearest = Infinity;
    for (let i = 0; i < count; i++) {
      const p = project(i, seen), off = Math.hypot(p.x - x, p.y - y);
      const cost = p.depth + (off / 12) * 0.05 * R;
      if (off < 12 && cost < nearest) [best, nearest] = [i, cost];
    }
    choose(best);
  };
  const focus = (id) => {
    const i = contacts.id.indexOf(id);
    if (i < 0) return;
    const n = contacts.normal.subarray(3 * i, 3 * i + 3), p = contacts.position.subarray(3 * i, 3 * i + 3);
    camera.target = Array.from(p);
    camera.azimuth = Math.atan2(n[1], n[0]) + 0.35;
    camera.elevation = Math.max(-1.4, Math.min(1.4, Math.atan2(n[2], Math.hypot(n[0], n[1])) + 0.25));
    camera.distance = 0.45 * wide();
    choose(i);
    box.scrollIntoView({ block: "nearest" });
  };
  const follow = () => {
    const match = /^#contact-(\d+)$/.exec(location.hash);
    if (match) focus(Number(match[1]));
  };

  // --------------------------------------------------------------------------------------------- the hands
  const look = (azimuth, elevation) => {
    Object.assign(camera, { azimuth, elevation, distance: wide(), target: [0, 0, 0] });
    redraw();
  };
  const turn = (dx, dy) => {
    camera.azimuth -= 0.008 * dx;
    camera.elevation = Math.max(-1.57, Math.min(1.57, camera.elevation + 0.008 * dy));
  };
  const pan = (dx, dy) => {
    const { right, up } = axes(), step = (2 * camera.distance * Math.tan(FIELD / 2)) / canvas.clientHeight;
    camera.target = camera.target.map((t, k) => t - step * (dx * right[k] - dy * up[k]));
  };
  const zoom = (factor) => { camera.distance = Math.max(0.08 * wide(), Math.min(4 * wide(), camera.distance * factor)); };
  const hands = new Map();
  let moved = 0;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    hands.set(event.pointerId, [event.clientX, event.clientY]);
    moved = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = hands.get(event.pointerId);
    if (!last) return;
    const [dx, dy] = [event.clientX - last[0], event.clientY - last[1]];
    if (hands.size === 2) {
      const other = [...hands].find(([id]) => id !== event.pointerId)[1];
      const before = Math.hypot(last[0] - other[0], last[1] - other[1]);
      const after = Math.hypot(event.clientX - other[0], event.clientY - other[1]);
      zoom(before / Math.max(after, 1));
      pan(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons & 6) pan(dx, dy);
    else turn(dx, dy);
    moved += Math.abs(dx) + Math.abs(dy);
    hands.set(event.pointerId, [event.clientX, event.clientY]);
    redraw();
  });
  for (const end of ["pointerup", "pointercancel"])
    canvas.addEventListener(end, (event) => {
      if (end === "pointerup" && moved < 5 && event.button === 0) {
        const frame = canvas.getBoundingClientRect();
        pick(event.clientX - frame.left, event.clientY - frame.top);
      }
      hands.delete(event.pointerId);
    });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => look(HOME.azimuth, HOME.elevation));
  let scrolled = -1e9; // a page that is being scrolled goes on scrolling over the canvas
  window.addEventListener("wheel", (event) => { if (event.target !== canvas) scrolled = event.timeStamp; },
                          { passive: true });
  canvas.addEventListener("wheel", (event) => {
    if (event.timeStamp - scrolled < 300 && !event.ctrlKey) { scrolled = event.timeStamp; return; }
    event.preventDefault();
    zoom(Math.exp(0.0012 * event.deltaY * (event.deltaMode ? 30 : 1)));
    redraw();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-12, 0], ArrowRight: [12, 0], ArrowUp: [0, -12], ArrowDown: [0, 12] };
    if (steps[event.key]) event.shiftKey ? pan(...steps[event.key]) : turn(...steps[event.key]);
    else if (event.key === "+" || event.key === "=") zoom(0.87);
    else if (event.key === "-") zoom(1.15);
    else if (event.key === "0") look(HOME.azimuth, HOME.elevation);
    else if (event.key === "Escape") choose(-1);
    else return;
    event.preventDefault();
    redraw();
  });
  const VIEWS = { home: [HOME.azimuth, HOME.elevation], front: [-Math.PI / 2, 0], right: [0, 0], back: [Math.PI / 2, 0],
                  left: [Math.PI, 0], top: [-Math.PI / 2, 1.57], bottom: [-Math.PI / 2, -1.57] };
  for (const button of document.querySelectorAll("[data-look]"))
    button.addEventListener("click", () => look(...VIEWS[button.dataset.look]));

  const fill = (select, items) => select.replaceChildren(...items.map(({ name, word }) => new Option(word, name)));
  fill($("contact-colour"), scene.contacts.shades);
  if (surface) fill($("surface-colour"), [...surface.fields, { name: "plain", word: "nothing: plain" }]);
  const fieldRange = () => {
    const field = shownField();
    if (field) Object.assign($("range"), { value: field.range, step: field.range / 10, min: field.range / 10 });
  };
  fieldRange();
  $("surface-colour").addEventListener("change", () => { fieldRange(); colourSurface(); redraw(); });
  $("range").addEventListener("input", () => { if (Number($("range").value) > 0) { colourSurface(); redraw(); } });
  $("contact-colour").addEventListener("change", () => { colourContacts(); redraw(); });
  for (const id of ["show-surface", "show-contours", "show-points", "show-normals", "show-marked", "cut", "cut-at"])
    $(id).addEventListener("input", redraw);
  for (const part of document.querySelectorAll(".needs-surface")) part.hidden = !surface;
  for (const part of document.querySelectorAll(".needs-marked")) part.hidden = !marked.length;
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => { setup(); redraw(); });
  window.addEventListener("hashchange", follow);
  document.addEventListener("click", (event) => { // a second click on the same link changes no hash
    const link = event.target.closest && event.target.closest("a[href^='#contact-']");
    if (link && link.hash === location.hash) follow();
  });
  setup();
  new ResizeObserver(redraw).observe(canvas);
  follow();
  draw();
  const pixels = new Uint8Array(4 * canvas.width * canvas.height);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  let covered = 0;
  for (let i = 3; i < pixels.length; i += 4) covered += pixels[i] > 0;
  page.dataset.viewerCovered = (covered / (canvas.width * canvas.height)).toFixed(4);
  page.dataset.viewerContacts = count;
  page.dataset.viewerFaces = surface ? surface.index.length / 3 : 0;
  const trouble = gl.getError();
  page.dataset.viewer = trouble ? "failed: WebGL error " + trouble : "ready";
})();
