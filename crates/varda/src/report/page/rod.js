"use strict";
// The rod in space: turned with the mouse, a finger or the arrow keys, played through time.
{
  const rod = varda.data.rod;
  const holder = document.getElementById("rod");
  const unpack = ({ step, values }) => Float32Array.from(values, (v) => v * step);
  const n = rod.arc_lengths.length;
  const runs = rod.runs.map((run) => ({ name: run.name, places: unpack(run.shapes) }));
  const sigma = rod.sigma.values.length ? unpack(rod.sigma) : null;
  const colours = rod.colours.map((c) => ({ name: c.name, unit: c.unit, values: unpack(c.values) }));
  const frames = rod.times.length;
  const analysis = runs.find((run) => run.name === "analysis") || runs[runs.length - 1];

  // The box around all that is shown.
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  const reach = (p, at) => { for (let c = 0; c < 3; c++) {
    low[c] = Math.min(low[c], p[at + c]);
    high[c] = Math.max(high[c], p[at + c]);
  } };
  // The analysis and what was seen: a background far off would make them small.
  for (let i = 0; i < analysis.places.length; i += 3) reach(analysis.places, i);
  rod.seen.forEach((s) => reach(s.place, 0));
  const middle = low.map((l, c) => 0.5 * (l + high[c]));
  const size = Math.max(Math.hypot(...low.map((l, c) => high[c] - l)), 1e-6);
  const thin = 0.006 * size;

  const element = (tag, properties, ...children) => {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...children);
    return made;
  };

  // ---- the controls
  const play = element("button", { type: "button", textContent: "Play", id: "rod-play" });
  const slider = element("input", { type: "range", min: 0, max: frames - 1, step: 1, value: 0, id: "rod-time" });
  slider.setAttribute("aria-label", "time");
  const clock = element("output", { id: "rod-clock" });
  clock.setAttribute("aria-live", "off");
  const speed = element("select", { id: "rod-speed" });
  [["0.1", "a tenth"], ["0.25", "a quarter"], ["1", "real time"], ["4", "4 times"]].forEach(([value, text]) =>
    speed.append(element("option", { value, textContent: text })));
  // The whole recording in about eight seconds.
  const span = rod.times[frames - 1] - rod.times[0];
  speed.value = span < 0.8 ? "0.1" : span < 3 ? "0.25" : span < 20 ? "1" : "4";
  const paint = element("select", { id: "rod-colour" });
  paint.append(element("option", { value: "", textContent: "one colour" }));
  colours.forEach((c, i) => paint.append(element("option", { value: i, textContent: c.name })));
  const labelled = (text, control) => element("label", {}, text + " ", control);
  const layers = {};
  const layer = (name, text, on) => {
    layers[name] = element("input", { type: "checkbox", checked: on, id: "rod-" + name });
    const mark = element("span", { className: "mark" });
    mark.dataset.colour = name;
    return element("label", {}, layers[name], mark, " " + text);
  };
  const choices = element("p", { className: "controls" });
  runs.forEach((run) => choices.append(layer(run.name, run.name, true)));
  if (sigma) choices.append(layer("tube", "±2σ of the analysis", true));
  if (rod.seen.some((s) => !s.kept_back)) choices.append(layer("observation", "observed", true));
  if (rod.seen.some((s) => s.kept_back)) choices.append(layer("withheld", "kept back", true));
  if (colours.length) choices.append(labelled("colour of the analysis", paint));
  const scale = element("p", { className: "scale", hidden: true });
  const moving = element("p", { className: "controls" }, play, slider, clock, labelled("speed", speed));
  if (frames < 2) moving.hidden = true;
  const view = element("div", { className: "canvas" });
  holder.append(view, moving, choices, scale);

  // ---- the scene
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  } catch (error) {
    view.textContent = "This browser does not show WebGL: the rod is below as a picture.";
    view.classList.add("none");
    document.querySelector("figure.rod details").open = true;
  }
  if (renderer) {
    const scene = new THREE.Scene();
    const camera = new THREE.PerspectiveCamera(35, 1.6, 0.01 * size, 100 * size);
    camera.up.set(0, 0, 1);
    const eye = new THREE.Vector3(-0.55, -1.6, 0.55).normalize().multiplyScalar(1.75 * size);
    const home = () => {
      camera.position.set(middle[0] + eye.x, middle[1] + eye.y, middle[2] + eye.z);
      controls.target.set(...middle);
      controls.update();
    };
    const canvas = renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "The rod");
    view.append(canvas);
    const controls = new THREE.OrbitControls(camera, canvas);
    home();
    scene.add(new THREE.AmbientLight(0xffffff, 1.6));
    const sun = new THREE.DirectionalLight(0xffffff, 1.8);
    sun.position.set(-1, -2, 3);
    scene.add(sun);

    // A grid of round cells under the rod.
    const power = 10 ** Math.floor(Math.log10(size / 4));
    const cell = power * (size / 4 / power >= 5 ? 5 : size / 4 / power >= 2 ? 2 : 1);
    const cells = 2 * Math.ceil(0.75 * size / cell);
    const grid = new THREE.GridHelper(cells * cell, cells);
    grid.rotation.x = Math.PI / 2;
    grid.position.set(Math.round(middle[0] / cell) * cell, Math.round(middle[1] / cell) * cell, low[2] - 2 * thin);
    scene.add(grid);
    const axes = ["x", "y", "z"].map((_, c) => {
      const corner = [grid.position.x - cells * cell / 2, grid.position.y - cells * cell / 2, grid.position.z];
      const end = corner.map((v, i) => v + (i === c ? cell : 0));
      const line = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial());
      line.geometry.setAttribute("position", new THREE.BufferAttribute(Float32Array.from([...corner, ...end]), 3));
      scene.add(line);
      return line;
    });

    // A tube around a curve: a ring of points at every vertex, joined by triangles.
    const RING = 10;
    const tube = (material) => {
      const geometry = new THREE.BufferGeometry();
      ["position", "normal", "color"].forEach((name) =>
        geometry.setAttribute(name, new THREE.BufferAttribute(new Float32Array(3 * n * RING), 3)));
      const faces = [];
      for (let i = 0; i + 1 < n; i++) for (let j = 0; j < RING; j++) {
        const [a, b] = [i * RING + j, i * RING + (j + 1) % RING];
        faces.push(a, a + RING, b, b, a + RING, b + RING);
      }
      geometry.setIndex(faces);
      const mesh = new THREE.Mesh(geometry, material);
      mesh.frustumCulled = false;
      scene.add(mesh);
      return mesh;
    };
    // Radii: `thin`, and twice σ in the direction of each point of a ring.
    const shape = (mesh, places, from, radius, sigmaFrom, shade) => {
      const { position, normal, color } = mesh.geometry.attributes;
      let across = null;
      for (let i = 0; i < n; i++) {
        const at = from + 3 * i;
        const [a, b] = [from + 3 * Math.max(i - 1, 0), from + 3 * Math.min(i + 1, n - 1)];
        const along = [0, 1, 2].map((c) => places[b + c] - places[a + c]);
        const length = Math.hypot(...along) || 1;
        along.forEach((v, c) => { along[c] = v / length; });
        // carried along the curve without turning about it
        if (!across) across = Math.abs(along[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0];
        const dot = across[0] * along[0] + across[1] * along[1] + across[2] * along[2];
        across = across.map((v, c) => v - dot * along[c]);
        const norm = Math.hypot(...across) || 1;
        across = across.map((v) => v / norm);
        const other = [along[1] * across[2] - along[2] * across[1], along[2] * across[0] - along[0] * across[2],
          along[0] * across[1] - along[1] * across[0]];
        const rgb = shade && shade(i);
        for (let j = 0; j < RING; j++) {
          const [cos, sin] = [Math.cos(2 * Math.PI * j / RING), Math.sin(2 * Math.PI * j / RING)];
          const k = 3 * (i * RING + j);
          let spread = 0;
          for (let c = 0; c < 3; c++) {
            normal.array[k + c] = cos * across[c] + sin * other[c];
            if (sigmaFrom >= 0) spread += (normal.array[k + c] * sigma[sigmaFrom + 3 * i + c]) ** 2;
          }
          const r = radius + 2 * Math.sqrt(spread);
          for (let c = 0; c < 3; c++) position.array[k + c] = places[at + c] + r * normal.array[k + c];
          if (rgb) color.array.set(rgb, k);
        }
      }
      position.needsUpdate = normal.needsUpdate = color.needsUpdate = true;
    };
    const meshes = runs.map((run) => tube(new THREE.MeshLambertMaterial()));
    const cloud = sigma && tube(new THREE.MeshBasicMaterial(
      { transparent: true, opacity: 0.25, depthWrite: false, side: THREE.DoubleSide }));
    const most = Math.max(1, ...rod.times.map((_, f) => rod.seen.filter((s) => s.frame === f).length));
    const balls = ["observation", "withheld"].map((name) => {
      const ball = new THREE.InstancedMesh(new THREE.SphereGeometry(2.2 * thin, 14, 10), new THREE.MeshLambertMaterial(), most);
      ball.frustumCulled = false;
      scene.add(ball);
      return { name, ball, seen: rod.seen.filter((s) => s.kept_back === (name === "withheld")) };
    });

    let frame = 0;
    const draw = () => {
      scene.background = new THREE.Color(varda.colour("card"));
      const painted = paint.value === "" ? null : colours[Number(paint.value)];
      let range = [0, 1];
      if (painted) range = painted.values.reduce(([l, h], v) => [Math.min(l, v), Math.max(h, v)], [Infinity, -Infinity]);
      runs.forEach((run, i) => {
        const own = painted && run === analysis;
        const material = meshes[i].material;
        if (material.vertexColors !== Boolean(own)) { material.vertexColors = Boolean(own); material.needsUpdate = true; }
        material.color.set(own ? "#ffffff" : varda.colour(run.name));
        meshes[i].visible = layers[run.name].checked;
        const shade = own && ((v) => {
          const x = (painted.values[frame * n + v] - range[0]) / (range[1] - range[0] || 1);
          return new THREE.Color(`rgb(${varda.viridis(x)})`).toArray();
        });
        shape(meshes[i], run.places, frame * 3 * n, run === analysis ? thin : 0.7 * thin, -1, shade);
      });
      if (cloud) {
        cloud.visible = layers.tube.checked;
        cloud.material.color.set(varda.colour("analysis"));
        shape(cloud, analysis.places, frame * 3 * n, 1.3 * thin, frame * 3 * n, null);
      }
      balls.forEach(({ name, ball, seen }) => {
        const here = layers[name] && layers[name].checked ? seen.filter((s) => s.frame === frame) : [];
        here.forEach((s, i) => ball.setMatrixAt(i, new THREE.Matrix4().setPosition(...s.place)));
        ball.count = here.length;
        ball.instanceMatrix.needsUpdate = true;
        ball.material.color.set(varda.colour(name));
      });
      grid.material.color.set(varda.colour("line"));
      grid.material.vertexColors = false;
      ["#d62728", "#2ca02c", "#1f77b4"].forEach((c, i) => axes[i].material.color.set(c));
      document.querySelectorAll("#rod .mark").forEach((mark) => {
        mark.style.background = varda.colour(mark.dataset.colour === "tube" ? "analysis" : mark.dataset.colour);
        mark.style.opacity = mark.dataset.colour === "tube" ? 0.35 : 1;
      });
      renderer.render(scene, camera);
      const t = rod.times[frame];
      const past = t > rod.window_end + 1e-9;
      clock.textContent = `t = ${varda.short(t)} s${past ? " (forecast)" : ""}`;
      slider.setAttribute("aria-valuetext", clock.textContent);
      canvas.setAttribute("aria-label", `The rod at ${varda.short(t)} s: ${runs.map((r) => r.name).join(", ")}. ` +
        "Drag or press the arrow keys to turn it, plus and minus to zoom, Home to return.");
      scale.hidden = !painted;
      if (painted) {
        const stops = [0, 0.25, 0.5, 0.75, 1].map((x) => `rgb(${varda.viridis(x)})`).join(",");
        scale.innerHTML = `${varda.short(range[0])} <span style="background:linear-gradient(90deg,${stops})"></span> ` +
          `${varda.short(range[1])} ${painted.unit}`;
      }
    };
    const resize = () => {
      const width = view.clientWidth;
      if (!width) return;
      const height = Math.round(Math.min(0.62 * width, 520));
      renderer.setPixelRatio(window.devicePixelRatio || 1);
      renderer.setSize(width, height);
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
      draw();
    };
    new ResizeObserver(() => requestAnimationFrame(resize)).observe(view);
    controls.addEventListener("change", () => renderer.render(scene, camera));
    const show = (f) => { frame = Math.min(Math.max(f, 0), frames - 1); slider.value = frame; draw(); };

    // ---- time
    let playing = null;
    const stop = () => { if (playing) cancelAnimationFrame(playing.request); playing = null; play.textContent = "Play"; };
    const start = () => {
      if (frame === frames - 1) show(0);
      playing = { since: performance.now(), from: rod.times[frame] };
      play.textContent = "Pause";
      const tick = (now) => {
        if (!playing) return;
        const t = playing.from + Number(speed.value) * (now - playing.since) / 1000;
        let f = frame;
        while (f < frames - 1 && rod.times[f + 1] <= t) f++;
        if (f !== frame) show(f);
        if (f === frames - 1) { stop(); return; }
        playing.request = requestAnimationFrame(tick);
      };
      playing.request = requestAnimationFrame(tick);
    };
    const toggle = () => (playing ? stop() : start());
    play.addEventListener("click", toggle);
    speed.addEventListener("change", () => { if (playing) { stop(); start(); } });
    slider.addEventListener("input", () => { stop(); show(Number(slider.value)); });
    paint.addEventListener("change", draw);
    Object.values(layers).forEach((box) => box.addEventListener("change", draw));

    // ---- keys on the picture
    const turn = (about, by) => {
      const from = camera.position.clone().sub(controls.target);
      const polar = Math.acos(from.z / from.length()), azimuth = Math.atan2(from.y, from.x), r = from.length();
      const p = Math.min(Math.max(polar + (about === "up" ? by : 0), 0.02), Math.PI - 0.02);
      const a = azimuth + (about === "round" ? by : 0);
      from.set(r * Math.sin(p) * Math.cos(a), r * Math.sin(p) * Math.sin(a), r * Math.cos(p));
      camera.position.copy(controls.target).add(from);
      controls.update();
      renderer.render(scene, camera);
    };
    const zoom = (by) => {
      camera.position.sub(controls.target).multiplyScalar(by).add(controls.target);
      controls.update();
      renderer.render(scene, camera);
    };
    const keys = {
      ArrowLeft: () => turn("round", -0.1), ArrowRight: () => turn("round", 0.1),
      ArrowUp: () => turn("up", -0.1), ArrowDown: () => turn("up", 0.1),
      "+": () => zoom(0.9), "-": () => zoom(1.1), Home: home, " ": toggle,
    };
    canvas.addEventListener("keydown", (event) => {
      if (!keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
    varda.redraw.push(draw);
    varda.rod = { show, camera, frame: () => frame, playing: () => Boolean(playing) };
    varda.drawn += 1;
  }
}
