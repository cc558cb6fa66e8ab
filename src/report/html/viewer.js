"use strict";
// The surface in plain WebGL: turned, moved, brought nearer, relit by two sliders or by dragging the light, and measured.
(() => {
  const canvas = document.getElementById("viewer");
  if (!canvas) return;
  const message = document.getElementById("viewer-message");
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) {
    message.textContent = "This browser shows no 3D here; open 6_fusion/asset.glb or mesh.glb in another program.";
    return;
  }
  const data = JSON.parse(document.getElementById("viewer-data").textContent);
  const packed = atob(document.getElementById("viewer-mesh").textContent);
  const bytes = new Uint8Array(packed.length);
  for (let i = 0; i < packed.length; i++) bytes[i] = packed.charCodeAt(i);

  const low = data.low, high = data.high;
  const center = low.map((l, a) => (l + high[a]) / 2);
  const extent = Math.max(...low.map((l, a) => high[a] - l));

  const compile = (kind, text) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    return shader;
  };
  const link = (vertex, fragment) => {
    const program = gl.createProgram();
    gl.attachShader(program, compile(gl.VERTEX_SHADER, vertex));
    gl.attachShader(program, compile(gl.FRAGMENT_SHADER, fragment));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    return program;
  };
  const surface = link(`
    attribute vec3 position, normal, color; attribute vec4 tangent; attribute vec2 place;
    uniform mat4 projection, view; uniform vec3 low, size;
    varying vec3 n, c, t, b; varying vec2 uv;
    void main() {
      vec4 p = view * vec4(low + position * size, 1.0);
      gl_Position = projection * p;
      n = mat3(view) * normal; c = color; uv = place;
      t = mat3(view) * tangent.xyz; b = cross(n, t) * sign(tangent.w);
    }`, `
    #ifdef GL_FRAGMENT_PRECISION_HIGH
    precision highp float;
    #else
    precision mediump float;
    #endif
    varying vec3 n, c, t, b; varying vec2 uv; uniform vec3 light; uniform int mode;
    uniform bool textured, plain; uniform sampler2D colors, normals;
    void main() {
      vec3 m = n;
      if (textured) { vec3 q = 2.0 * texture2D(normals, uv).xyz - 1.0; m = q.x * t + q.y * b + q.z * n; }
      m = normalize(m);
      // The back of the surface, as through a hole, is dim.
      if (m.z < -0.25) gl_FragColor = vec4(vec3(0.18 + 0.1 * abs(m.z)), 1.0);
      else if (mode == 1) gl_FragColor = textured ? texture2D(colors, uv) : vec4(plain ? vec3(0.6) : c, 1.0);
      else if (mode == 2) gl_FragColor = vec4(0.5 + 0.5 * m, 1.0);
      else { float s = 0.12 + 0.88 * max(dot(m, light), 0.0); gl_FragColor = vec4(vec3(pow(s, 0.4545)), 1.0); }
    }`);
  const lines = link(`
    attribute vec3 position; uniform mat4 projection, view;
    void main() { gl_Position = projection * view * vec4(position, 1.0); }`, `
    precision mediump float; void main() { gl_FragColor = vec4(1.0, 0.83, 0.0, 1.0); }`);

  const record = 18, vertexBytes = record * data.vertices;
  const vertices = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, vertices);
  gl.bufferData(gl.ARRAY_BUFFER, bytes.subarray(0, vertexBytes), gl.STATIC_DRAW);
  const triangles = gl.createBuffer();
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, triangles);
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, bytes.subarray(vertexBytes), gl.STATIC_DRAW);
  const numCorners = (bytes.length - vertexBytes) / 2;
  const words = new DataView(bytes.buffer);
  const vertex = (k) => low.map((l, a) => l + words.getUint16(record * k + 2 * a, true) / 65535 * (high[a] - l));

  // Textures appear when they are decoded. Smaller levels would mix what lies side by side on them.
  let textured = false;
  const textures = (data.textures || []).map((url) => ({ url, texture: gl.createTexture() }));
  Promise.all(textures.map(({ url, texture }) => new Promise((done, failed) => {
    const image = new Image();
    image.onload = () => {
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image);
      for (const [name, value] of [["TEXTURE_MIN_FILTER", "LINEAR"], ["TEXTURE_WRAP_S", "CLAMP_TO_EDGE"],
        ["TEXTURE_WRAP_T", "CLAMP_TO_EDGE"]]) gl.texParameteri(gl.TEXTURE_2D, gl[name], gl[value]);
      done();
    };
    image.onerror = failed;
    image.src = url;
  }))).then(() => { textured = textures.length === 2; redraw(); })
    .catch(() => { message.textContent = "The textures cannot be shown; the surface is drawn without them."; });

  // A camera is drawn as the pyramid that its frame spans at a fifteenth of the object's size.
  const segments = [];
  for (const camera of data.cameras) {
    const right = [
      camera.forward[1] * camera.up[2] - camera.forward[2] * camera.up[1],
      camera.forward[2] * camera.up[0] - camera.forward[0] * camera.up[2],
      camera.forward[0] * camera.up[1] - camera.forward[1] * camera.up[0]];
    const at = (x, y) => camera.center.map((c, a) => c + extent / 6 * (camera.forward[a]
      + x * camera.half * camera.aspect * right[a] + y * camera.half * camera.up[a]));
    const corners = [at(-1, -1), at(1, -1), at(1, 1), at(-1, 1)];
    corners.forEach((corner, k) => segments.push(...camera.center, ...corner, ...corner, ...corners[(k + 1) % 4]));
  }
  const frusta = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, frusta);
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(segments), gl.STATIC_DRAW);

  // The start looks from the middle camera, whose up is the world's up here.
  const first = data.cameras[Math.floor(data.cameras.length / 2)] || { forward: [0, 0, 1], up: [0, -1, 0] };
  const back = first.forward.map((v) => -v);
  const upward = first.up;
  const side = [upward[1] * back[2] - upward[2] * back[1], upward[2] * back[0] - upward[0] * back[2],
    upward[0] * back[1] - upward[1] * back[0]];
  let turn, tilt, distance, shift;
  const home = () => { turn = 0; tilt = 0; distance = 1.9 * extent; shift = [0, 0]; };
  home();

  const viewMatrix = () => {
    const [ct, st, cp, sp] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
    const rows = [0, 1, 2].map(() => [0, 0, 0]);
    for (let a = 0; a < 3; a++) {
      const x = ct * side[a] - st * back[a], z = st * side[a] + ct * back[a], y = upward[a];
      rows[0][a] = x; rows[1][a] = cp * y - sp * z; rows[2][a] = sp * y + cp * z;
    }
    const m = new Float32Array(16);
    for (let r = 0; r < 3; r++) {
      for (let c = 0; c < 3; c++) m[4 * c + r] = rows[r][c];
      m[12 + r] = -(rows[r][0] * center[0] + rows[r][1] * center[1] + rows[r][2] * center[2]);
    }
    m[12] += shift[0]; m[13] += shift[1]; m[14] -= distance; m[15] = 1;
    return m;
  };

  const named = (length) => data.metric
    ? (length < 1e-3 ? `${(1e6 * length).toPrecision(3)} µm` : length < 1 ? `${(1e3 * length).toPrecision(4)} mm`
      : `${length.toPrecision(4)} m`)
    : `${length.toPrecision(4)} of the cameras' units`;
  // A bar of 1, 2 or 5 times a power of ten, at the distance of the object's middle.
  const showScale = (pixels) => {
    const most = 140 / pixels, power = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].map((k) => k * power).find((l) => l <= most) || power;
    const bar = document.getElementById("viewer-scale");
    bar.style.width = `${length * pixels}px`;
    bar.firstElementChild.textContent = data.metric
      ? (length < 1 ? `${Number((1e3 * length).toPrecision(3))} mm` : `${length} m`) : `${length} of the cameras' units`;
  };
  const ruler = gl.createBuffer();
  let chosen = [];
  // The vertex nearest to the place among those that lie in front there.
  const choose = (x, y) => {
    const m = viewMatrix(), f = 1 / Math.tan(Math.PI / 9), half = canvas.clientHeight / 2;
    let best = null, cost = Infinity;
    for (let k = 0; k < data.vertices; k++) {
      const p = vertex(k);
      const [u, v, w] = [0, 1, 2].map((r) => m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r]);
      const off = Math.hypot(canvas.clientWidth / 2 + f * half * u / -w - x, half - f * half * v / -w - y);
      if (w >= 0 || off > 12) continue;
      // A pixel aside counts as little as three hundredths of the object further back.
      const c = -w + 0.03 * extent * off;
      if (c < cost) { cost = c; best = p; }
    }
    if (!best) { message.textContent = "There is no surface here."; return; }
    chosen = chosen.length === 1 ? [chosen[0], best] : [best];
    message.textContent = chosen.length === 1 ? "Choose the second point."
      : `Distance: ${named(Math.hypot(...chosen[0].map((v, a) => v - chosen[1][a])))}`;
  };

  const control = (id) => document.getElementById(id);
  let queued = false;
  const draw = () => {
    queued = false;
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0.14, 0.15, 0.17, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const near = distance / 100, far = distance * 20, f = 1 / Math.tan(Math.PI / 9);
    const projection = new Float32Array([f * canvas.height / canvas.width, 0, 0, 0, 0, f, 0, 0,
      0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0]);
    const view = viewMatrix();
    const use = (program) => {
      gl.useProgram(program);
      gl.uniformMatrix4fv(gl.getUniformLocation(program, "projection"), false, projection);
      gl.uniformMatrix4fv(gl.getUniformLocation(program, "view"), false, view);
    };
    use(surface);
    const uniform = (name) => gl.getUniformLocation(surface, name);
    gl.uniform3fv(uniform("low"), low);
    gl.uniform3fv(uniform("size"), low.map((l, a) => high[a] - l));
    const [a, b] = [control("light-x").value * Math.PI / 180, control("light-y").value * Math.PI / 180];
    gl.uniform3f(uniform("light"), Math.sin(a) * Math.cos(b), Math.sin(b), Math.cos(a) * Math.cos(b));
    gl.uniform1i(uniform("mode"), Number(control("viewer-mode").value));
    gl.uniform1i(uniform("textured"), textured ? 1 : 0);
    // Vertices of a surface with textures have no colours.
    gl.uniform1i(uniform("plain"), data.textures ? 1 : 0);
    textures.forEach(({ texture }, k) => {
      gl.activeTexture(gl.TEXTURE0 + k);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    });
    gl.uniform1i(uniform("colors"), 0);
    gl.uniform1i(uniform("normals"), 1);
    gl.bindBuffer(gl.ARRAY_BUFFER, vertices);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, triangles);
    const attribute = (name, size, type, offset) => {
      const location = gl.getAttribLocation(surface, name);
      if (location < 0) return;
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, size, type, true, record, offset);
    };
    attribute("position", 3, gl.UNSIGNED_SHORT, 0);
    attribute("place", 2, gl.UNSIGNED_SHORT, 6);
    attribute("normal", 3, gl.BYTE, 10);
    attribute("tangent", 4, gl.BYTE, 13);
    attribute("color", 3, gl.UNSIGNED_BYTE, 13);
    gl.drawElements(gl.TRIANGLES, numCorners, gl.UNSIGNED_SHORT, 0);
    for (const name of ["position", "place", "normal", "tangent", "color"]) {
      const location = gl.getAttribLocation(surface, name);
      if (location >= 0) gl.disableVertexAttribArray(location);
    }
    const segment = (buffer, count) => {
      use(lines);
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      const location = gl.getAttribLocation(lines, "position");
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, 3, gl.FLOAT, false, 0, 0);
      gl.drawArrays(gl.LINES, 0, count);
      gl.disableVertexAttribArray(location);
    };
    if (control("viewer-cameras").checked) segment(frusta, segments.length / 3);
    if (chosen.length) {
      gl.disable(gl.DEPTH_TEST);
      const arm = extent / 60;
      const cross = (p) => [0, 1, 2].flatMap((a) => [-arm, arm].flatMap((d) => p.map((v, k) => v + (k === a ? d : 0))));
      const marks = chosen.flatMap(cross).concat(chosen.length > 1 ? chosen.flat() : []);
      gl.bindBuffer(gl.ARRAY_BUFFER, ruler);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(marks), gl.DYNAMIC_DRAW);
      segment(ruler, marks.length / 3);
    }
    showScale(f * canvas.clientHeight / 2 / distance);
  };
  const redraw = () => { if (!queued) { queued = true; requestAnimationFrame(draw); } };

  const limit = (angle) => Math.max(-1.5, Math.min(1.5, angle));
  // One pointer turns; two, another button or shift move and come nearer. A finger that moves up or down scrolls the page.
  const pointers = new Map();
  let moved = 0;
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, size: Math.hypot(a.x - b.x, a.y - b.y) };
  };
  const pan = (dx, dy) => {
    const pixels = canvas.clientHeight / 2 / Math.tan(Math.PI / 9) / distance;
    shift = [shift[0] + dx / pixels, shift[1] - dy / pixels];
  };
  canvas.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    canvas.setPointerCapture(event.pointerId);
    if (pointers.size === 1) moved = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId);
    if (!last) return;
    const before = pointers.size === 2 ? spread() : null;
    const [dx, dy] = [event.offsetX - last.x, event.offsetY - last.y];
    pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    moved += Math.abs(dx) + Math.abs(dy);
    if (before) {
      const now = spread();
      pan(now.x - before.x, now.y - before.y);
      distance *= before.size / Math.max(now.size, 1);
    } else if (event.shiftKey || event.buttons & 6) {
      pan(dx, dy);
    } else if (control("viewer-light").checked) {
      for (const [id, step] of [["light-x", dx], ["light-y", -dy]]) {
        control(id).value = Number(control(id).value) + step / 2;
      }
    } else {
      turn -= dx / 200;
      tilt = limit(tilt - dy / 200);
    }
    redraw();
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => {
    const single = pointers.size === 1;
    pointers.delete(event.pointerId);
    if (end === "pointerup" && single && moved < 4 && control("viewer-measure").checked) {
      choose(event.offsetX, event.offsetY);
      redraw();
    }
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    // The page scrolls on until the view was clicked.
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    distance *= Math.exp(event.deltaY / 800);
    redraw();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const keys = {
      ArrowLeft: () => { turn += 0.1; }, ArrowRight: () => { turn -= 0.1; },
      ArrowUp: () => { tilt = limit(tilt + 0.1); }, ArrowDown: () => { tilt = limit(tilt - 0.1); },
      "+": () => { distance /= 1.15; }, "-": () => { distance *= 1.15; }, "0": home,
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
    redraw();
  });
  control("viewer-cameras").addEventListener("input", () => {
    const reach = Math.max(...data.cameras.map((c) => Math.hypot(...c.center.map((v, a) => v - center[a]))), 0);
    if (control("viewer-cameras").checked) distance = Math.max(distance, 3.2 * reach);
    else home();
  });
  control("viewer-measure").addEventListener("input", () => { chosen = []; message.textContent = ""; redraw(); });
  for (const id of ["viewer-mode", "light-x", "light-y", "viewer-cameras"]) control(id).addEventListener("input", redraw);
  window.addEventListener("resize", redraw);
  redraw();
})();
