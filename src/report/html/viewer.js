"use strict";
// The cloud in plain WebGL: turned by drag or arrow keys, relit by two sliders.
(() => {
  const canvas = document.getElementById("viewer");
  if (!canvas) return;
  const message = document.getElementById("viewer-message");
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) {
    message.textContent = "This browser shows no 3D here; open 6_fusion/cloud.ply in another program.";
    return;
  }
  const data = JSON.parse(document.getElementById("viewer-data").textContent);
  const packed = atob(document.getElementById("viewer-points").textContent);
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
  const points = link(`
    attribute vec3 position, normal, color;
    uniform mat4 projection, view; uniform vec3 low, size; uniform float pointSize;
    varying vec3 n, c;
    void main() {
      vec4 p = view * vec4(low + position * size, 1.0);
      gl_Position = projection * p;
      gl_PointSize = clamp(pointSize / -p.z, 1.0, 24.0);
      n = mat3(view) * normal; c = color;
    }`, `
    precision mediump float;
    varying vec3 n, c; uniform vec3 light; uniform int mode;
    void main() {
      vec3 m = normalize(n);
      if (mode == 1) gl_FragColor = vec4(c, 1.0);
      else if (mode == 2) gl_FragColor = vec4(0.5 + 0.5 * m, 1.0);
      else { float s = 0.12 + 0.88 * max(dot(m, light), 0.0); gl_FragColor = vec4(vec3(pow(s, 0.4545)), 1.0); }
    }`);
  const lines = link(`
    attribute vec3 position; uniform mat4 projection, view;
    void main() { gl_Position = projection * view * vec4(position, 1.0); }`, `
    precision mediump float; void main() { gl_FragColor = vec4(1.0, 0.83, 0.0, 1.0); }`);

  const cloud = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, cloud);
  gl.bufferData(gl.ARRAY_BUFFER, bytes, gl.STATIC_DRAW);

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
  let turn, tilt, distance;
  const home = () => { turn = 0; tilt = 0; distance = 1.9 * extent; };
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
    m[14] -= distance; m[15] = 1;
    return m;
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
    use(points);
    const uniform = (name) => gl.getUniformLocation(points, name);
    gl.uniform3fv(uniform("low"), low);
    gl.uniform3fv(uniform("size"), low.map((l, a) => high[a] - l));
    // Points as large as their mean distance on a surface of the box's size leave no gaps.
    const spacing = extent * Math.sqrt(1.6 / data.count);
    gl.uniform1f(uniform("pointSize"), 1.6 * spacing * f * canvas.height / 2);
    const [a, b] = [control("light-x").value * Math.PI / 180, control("light-y").value * Math.PI / 180];
    gl.uniform3f(uniform("light"), Math.sin(a) * Math.cos(b), Math.sin(b), Math.cos(a) * Math.cos(b));
    gl.uniform1i(uniform("mode"), Number(control("viewer-mode").value));
    gl.bindBuffer(gl.ARRAY_BUFFER, cloud);
    const attribute = (name, type, offset) => {
      const location = gl.getAttribLocation(points, name);
      if (location < 0) return;
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, 3, type, true, 12, offset);
    };
    attribute("position", gl.UNSIGNED_SHORT, 0);
    attribute("normal", gl.BYTE, 6);
    attribute("color", gl.UNSIGNED_BYTE, 9);
    gl.drawArrays(gl.POINTS, 0, data.count);
    for (const name of ["position", "normal", "color"]) {
      const location = gl.getAttribLocation(points, name);
      if (location >= 0) gl.disableVertexAttribArray(location);
    }
    if (control("viewer-cameras").checked) {
      use(lines);
      gl.bindBuffer(gl.ARRAY_BUFFER, frusta);
      const location = gl.getAttribLocation(lines, "position");
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, 3, gl.FLOAT, false, 0, 0);
      gl.drawArrays(gl.LINES, 0, segments.length / 3);
      gl.disableVertexAttribArray(location);
    }
  };
  const redraw = () => { if (!queued) { queued = true; requestAnimationFrame(draw); } };

  const limit = (angle) => Math.max(-1.5, Math.min(1.5, angle));
  canvas.addEventListener("pointermove", (event) => {
    if (!(event.buttons & 1)) return;
    turn -= event.movementX / 200;
    tilt = limit(tilt - event.movementY / 200);
    redraw();
  });
  canvas.addEventListener("wheel", (event) => {
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
  for (const id of ["viewer-mode", "light-x", "light-y", "viewer-cameras"]) control(id).addEventListener("input", redraw);
  window.addEventListener("resize", redraw);
  redraw();
})();
