"use strict";
// Replays of runs in 3-D.  One renderer for the page: it is lent to the replay that is looked at.
(() => {
  const figures = [...document.querySelectorAll("figure.replay")];
  if (!figures.length) return;
  const quiet = matchMedia("(prefers-reduced-motion: reduce)");
  const inked = (name) => new THREE.Color(getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  const floats = (text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  };
  const point = (array, place) => new THREE.Vector3(array[place], array[place + 1], array[place + 2]);
  const matrix = (rows) => new THREE.Matrix4().set(...rows);
  const UP = new THREE.Vector3(0, 1, 0);

  let renderer = null;
  const lend = (stage) => {
    if (!renderer) {
      renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, failIfMajorPerformanceCaveat: false });
      renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
      renderer.domElement.setAttribute("aria-hidden", "true");
    }
    stage.prepend(renderer.domElement);
    return renderer;
  };

  class Body {  // a capsule whose two ends move, or stand still in the frame of its link
    constructor(radius, length, material) {
      this.mesh = new THREE.Mesh(new THREE.CapsuleGeometry(radius, length, 8, 20), material);
    }
    place(start, end) {
      const along = end.clone().sub(start);
      this.mesh.position.copy(start).addScaledVector(along, 0.5);
      if (along.lengthSq() > 0) this.mesh.quaternion.setFromUnitVectors(UP, along.normalize());
    }
  }

  class Replay {
    constructor(figure) {
      this.figure = figure;
      this.stage = figure.querySelector(".stage");
      this.play = figure.querySelector(".play");
      this.scrub = figure.querySelector(".scrub");
      this.clock = figure.querySelector(".clock");
      this.says = figure.querySelector(".says-now");
      this.speed = figure.querySelector(".speed");
      this.data = JSON.parse(document.getElementById(figure.dataset.run).textContent);
      this.columns = Object.fromEntries(Object.entries(this.data.columns).map(([name, text]) => [name, floats(text)]));
      this.times = this.columns.time_s;
      this.last = this.times[this.times.length - 1];
      this.now = Number(figure.dataset.from);
      this.frame = 0;
      this.play.addEventListener("click", () => (this.frame ? this.pause() : this.start()));
      this.scrub.addEventListener("input", () => { this.pause(); this.show(Number(this.scrub.value)); });
      for (const jump of figure.querySelectorAll("[data-jump]")) {
        jump.addEventListener("click", () => { this.pause(); this.show(Number(jump.dataset.jump)); });
      }
      for (const view of figure.querySelectorAll("[data-view]")) {
        view.addEventListener("click", () => { this.wake(); this.look(view.dataset.view); });
      }
      this.stage.addEventListener("keydown", (event) => this.turn(event));
      this.show(this.now);
    }

    wake() {  // build the scene when it is first looked at, and take the page's renderer
      if (Replay.awake === this) return true;
      try {
        const lent = lend(this.stage);
        if (!this.scene) this.build();
        if (Replay.awake) { Replay.awake.pause(); Replay.awake.controls.enabled = false; }
        Replay.awake = this;
        this.renderer = lent;
        this.orbit();
        this.resize();
        this.figure.dataset.state = "ready";
        return true;
      } catch (error) {
        this.figure.dataset.state = "unavailable";
        this.stage.querySelector(".stage-note").textContent =
          "This browser shows no 3-D (WebGL is off or missing). The drawings above show the same run.";
        return false;
      }
    }

    build() {
      const data = this.data;
      this.scene = new THREE.Scene();
      this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8f94, 2.2));
      const sun = new THREE.DirectionalLight(0xffffff, 1.6);
      sun.position.set(1.5, -2, 3);
      this.scene.add(sun);
      this.camera = new THREE.PerspectiveCamera(38, 1, 0.02, 30);
      this.camera.up.set(0, 0, 1);
      this.materials = {};
      const solid = (ink, more = {}) => this.ink(new THREE.MeshLambertMaterial(more), ink);
      const stroke = (ink, more = {}) => this.ink(new THREE.LineBasicMaterial(more), ink);
      // the table, the object on it and the boxes beside it
      const table = new THREE.GridHelper(2.4, 24, 0xffffff, 0xffffff);
      table.material = stroke("--fig-grid");
      table.rotation.x = Math.PI / 2;
      table.position.set(0.6, 0, data.table_height_m - 0.001);
      this.scene.add(table);
      const shape = data.object_in_base_m.map((corner) => new THREE.Vector3(...corner));
      this.scene.add(new THREE.LineLoop(new THREE.BufferGeometry().setFromPoints(shape), stroke("--fig-object")));
      for (const corners of data.boxes_in_base_m.flat()) {
        const face = corners.map((corner) => new THREE.Vector3(...corner));
        this.scene.add(new THREE.LineLoop(new THREE.BufferGeometry().setFromPoints(face), stroke("--fig-text")));
      }
      // the arm: frame within frame, as its joints are
      const links = [new THREE.Group()];
      this.scene.add(links[0]);
      this.joints = data.joint_origins.map((rows, k) => {
        const origin = new THREE.Group();
        origin.matrixAutoUpdate = false;
        origin.matrix.copy(matrix(rows));
        const turned = new THREE.Group();
        origin.add(turned);
        links[k].add(origin);
        links.push(turned);
        return { turned, axis: new THREE.Vector3(...data.joint_axes[k]) };
      });
      const tool = new THREE.Group();
      tool.matrixAutoUpdate = false;
      tool.matrix.copy(matrix(data.flange));
      links[this.joints.length].add(tool);
      links.push(tool);
      this.tool = tool;
      this.capsules = data.capsules.map((one) => {
        const start = new THREE.Vector3(...one.start), end = new THREE.Vector3(...one.end);
        const body = new Body(one.radius_m, start.distanceTo(end), solid("--replay-arm"));
        body.mesh.material.transparent = true;
        body.mesh.material.opacity = 0.94;
        body.place(start, end);
        links[one.link].add(body.mesh);
        return body.mesh;
      });
      for (const { link, corners, triangles } of data.meshes ?? []) {  // within capsules that are then clear
        const shape = new THREE.BufferGeometry();
        shape.setAttribute("position", new THREE.BufferAttribute(floats(corners), 3));
        shape.setIndex([...floats(triangles)]);
        links[link].add(new THREE.Mesh(shape, solid("--replay-arm", { side: THREE.DoubleSide, flatShading: true })));
      }
      this.clear = Boolean(data.meshes?.length);
      if (this.clear) for (const { material } of this.capsules) Object.assign(material, { opacity: 0.22, depthWrite: false });
      // hands with forearms, and where they are predicted
      this.hands = data.hands.map((name, k) => {
        const ink = `--fig-hand-${k + 1}`;
        const hand = new THREE.Mesh(new THREE.SphereGeometry(data.hand_radius_m, 28, 18), solid(ink));
        const forearm = new Body(data.forearm_radius_m, data.forearm_length_m, solid(ink, { transparent: true, opacity: 0.55 }));
        this.scene.add(hand, forearm.mesh);
        return { hand, forearm };
      });
      this.tracks = Array.from({ length: data.tracks }, () => {
        const mark = new THREE.Mesh(
          new THREE.SphereGeometry(data.hand_radius_m, 14, 10),
          this.ink(new THREE.MeshBasicMaterial({ wireframe: true, transparent: true, opacity: 0.5 }), "--fig-predicted"));
        this.scene.add(mark);
        return mark;
      });
      // the way of the TCP, the critical distance about it, the positions that were chosen
      const way = [];
      for (let k = 0; k < this.times.length; k++) way.push(point(this.columns.tcp_in_base_m, 3 * k));
      const path = new THREE.BufferGeometry().setFromPoints(way);
      const measured = new THREE.BufferGeometry().setFromPoints(way.filter((at) => Number.isFinite(at.x)));
      measured.computeBoundingSphere();
      path.boundingSphere = measured.boundingSphere;
      this.scene.add(new THREE.Line(path, stroke("--fig-muted", { transparent: true, opacity: 0.45 })));
      this.travelled = new THREE.Line(path.clone(), stroke("--fig-tcp"));
      this.scene.add(this.travelled);
      this.critical = new THREE.Group();  // three great circles
      const ring = Array.from({ length: 96 }, (_, k) => new THREE.Vector3(
        Math.cos((k * Math.PI) / 48), Math.sin((k * Math.PI) / 48), 0).multiplyScalar(data.critical_distance_m));
      for (const turn of [[0, 0, 0], [Math.PI / 2, 0, 0], [0, Math.PI / 2, 0]]) {
        const circle = new THREE.LineLoop(
          new THREE.BufferGeometry().setFromPoints(ring), stroke("--fig-limit", { transparent: true, opacity: 0.45 }));
        circle.rotation.set(...turn);
        this.critical.add(circle);
      }
      this.scene.add(this.critical);
      this.chosen = data.decisions.filter((one) => one.chosen_in_base_m).map((one) => {
        const mark = new THREE.Mesh(new THREE.SphereGeometry(0.014, 4, 2), solid("--fig-chosen"));
        mark.position.set(...one.chosen_in_base_m);
        this.scene.add(mark);
        return { mark, from_s: one.time_s };
      });
      this.dress();
    }

    ink(material, name) {
      (this.materials[name] ??= []).push(material);
      return material;
    }

    dress() {  // the page's colours, light or dark
      for (const [name, own] of Object.entries(this.materials)) own.forEach((one) => one.color.copy(inked(name)));
      this.plain = inked("--replay-arm");
      this.marked = inked("--fig-tcp");
    }

    orbit() {
      this.controls?.dispose();
      this.controls = new THREE.OrbitControls(this.camera, this.renderer.domElement);
      this.controls.enablePan = false;
      this.controls.enableZoom = this.stage.contains(document.activeElement);
      this.controls.minDistance = 0.4;
      this.controls.maxDistance = 8;
      this.renderer.domElement.style.touchAction = "pan-y";  // a finger that moves up or down scrolls the page
      this.controls.addEventListener("change", () => this.draw());
      this.stage.onfocus = () => { this.controls.enableZoom = true; };
      this.stage.onblur = () => { this.controls.enableZoom = false; };
      this.look(this.view ?? "oblique");
    }

    look(view) {
      this.view = view;
      const tcp = new THREE.Vector3(...this.data.desired_tcp_in_base_m);
      const size = this.data.size_m ?? 1;
      const target = this.data.size_m ? tcp : new THREE.Vector3(tcp.x * 0.62, tcp.y - 0.1, 0.12);
      const from = { oblique: [1.75, -1.75, 1.15], top: [0, -0.01, 3.1], side: [0, -3.1, 0.1], front: [3.1, 0, 0.25] }[view];
      this.controls.target.copy(target);
      this.camera.position.copy(target).addScaledVector(new THREE.Vector3(...from), size);
      this.controls.update();
      this.figure.querySelectorAll("[data-view]").forEach((one) => one.setAttribute("aria-pressed", one.dataset.view === view));
      this.draw();
    }

    turn(event) {
      const turns = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1], "+": [0, 0, 0.9], "=": [0, 0, 0.9], "-": [0, 0, 1.1] };
      const turned = turns[event.key];
      if (event.target !== this.stage) return;
      if (event.key === " ") { event.preventDefault(); this.play.click(); return; }
      if (!turned || !this.wake()) return;
      event.preventDefault();
      const arm = this.camera.position.clone().sub(this.controls.target);
      const flat = Math.hypot(arm.x, arm.y), size = arm.length() * (turned[2] ?? 1);
      const azimuth = Math.atan2(arm.y, arm.x) + turned[0] * 0.1;
      const height = Math.min(1.5, Math.max(-0.3, Math.atan2(arm.z, flat) - turned[1] * 0.08));
      arm.set(Math.cos(azimuth) * Math.cos(height), Math.sin(azimuth) * Math.cos(height), Math.sin(height));
      this.camera.position.copy(this.controls.target).addScaledVector(arm, size);
      this.controls.update();
      this.draw();
    }

    resize() {
      const { clientWidth: width, clientHeight: height } = this.stage;
      if (!width || !height || Replay.awake !== this) return;
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      this.draw();
    }

    start() {
      if (!this.wake()) return;
      if (this.now >= this.last) this.now = this.times[0];
      this.play.textContent = "Pause";
      this.figure.dataset.state = "playing";
      let before = performance.now();
      const step = (moment) => {
        this.show(Math.min(this.last, this.now + Number(this.speed.value) * (moment - before) / 1000));
        before = moment;
        if (this.now >= this.last) this.pause(); else this.frame = requestAnimationFrame(step);
      };
      this.frame = requestAnimationFrame(step);
    }

    pause() {
      cancelAnimationFrame(this.frame);
      this.frame = 0;
      this.play.textContent = "Play";
      if (this.figure.dataset.state === "playing") this.figure.dataset.state = "paused";
    }

    at(time) {  // the tick before a time, and how far it is on the way to the next one
      let low = 0, high = this.times.length - 1;
      while (high - low > 1) {
        const middle = (low + high) >> 1;
        if (this.times[middle] <= time) low = middle; else high = middle;
      }
      if (time >= this.times[high]) return [high, high, 0];
      return [low, high, Math.max(0, (time - this.times[low]) / (this.times[high] - this.times[low]))];
    }

    between(name, size, [a, b, share], offset = 0, count = size) {
      const column = this.columns[name], found = [];
      for (let k = 0; k < count; k++) {
        const x = column[a * size + offset + k], y = column[b * size + offset + k];
        found.push(x + share * (y - x));
      }
      return found;
    }

    show(time) {
      this.now = time;
      this.scrub.value = time;
      this.figure.dataset.time = time.toFixed(3);
      const moment = this.at(time), tick = moment[2] > 0.5 ? moment[1] : moment[0];
      this.clock.textContent = `${time.toFixed(2)} s`;
      const parts = this.data.hands.map((name, k) => {
        const distance = this.columns.hand_distance_m[tick * this.data.hands.length + k];
        const far = Number.isFinite(distance) ? `${(distance * 1000).toFixed(0)} mm` : Number.isNaN(distance) ? "not measured" : "absent";
        return `${name} ${far}`.replace("-", "\u2212");
      });
      parts.unshift(this.data.modes[this.columns.mode[tick]]);
      this.says.textContent = parts.join(" \u00b7 ");
      this.scrub.setAttribute("aria-valuetext", `${time.toFixed(2)} seconds, ${parts.join(", ")}`);
      if (this.scene) { this.pose(moment); this.draw(); }
    }

    pose(moment) {
      const tick = moment[0], data = this.data;
      const angles = this.between("joint_position_rad", this.joints.length, moment);
      this.joints.forEach(({ turned, axis }, k) => turned.quaternion.setFromAxisAngle(axis, angles[k]));
      const tcp = new THREE.Vector3(...this.between("tcp_in_base_m", 3, moment));
      this.critical.position.copy(tcp);
      this.travelled.geometry.setDrawRange(0, tick + 1);
      this.capsules.forEach((mesh) => mesh.material.color.copy(this.clear ? this.marked : this.plain));
      this.hands.forEach(({ hand, forearm }, k) => {
        const count = data.hands.length, nearest = this.columns.nearest_capsule[tick * count + k];
        const here = nearest >= 0;
        hand.visible = here;
        forearm.mesh.visible = here;
        if (!here) return;
        const start = new THREE.Vector3(...this.between("hand_in_base_m", 3 * count, moment, 3 * k, 3));
        const elbow = new THREE.Vector3(...this.between("elbow_in_base_m", 3 * count, moment, 3 * k, 3));
        hand.position.copy(start);
        const along = elbow.clone().sub(start);
        forearm.mesh.visible = along.lengthSq() > 0;
        forearm.place(start, start.clone().addScaledVector(along.normalize(), data.forearm_length_m));
        if (this.capsules[nearest]) this.capsules[nearest].material.color.copy(this.marked);
      });
      this.tracks.forEach((mark, k) => {
        const place = (tick * data.tracks + k) * 3, column = this.columns.predicted_in_base_m;
        mark.visible = Number.isFinite(column[place]);
        if (mark.visible) mark.position.copy(point(column, place));
      });
      this.chosen.forEach(({ mark, from_s }) => { mark.visible = from_s <= this.now; });
    }

    draw() {
      if (Replay.awake !== this || !this.scene) return;
      this.renderer.render(this.scene, this.camera);
      this.tool.updateWorldMatrix(true, false);
      const reached = new THREE.Vector3().setFromMatrixPosition(this.tool.matrixWorld);
      this.figure.dataset.tcp = reached.toArray().map((value) => value.toFixed(4)).join(" ");
      this.figure.dataset.triangles = this.renderer.info.render.triangles;
    }
  }
  Replay.awake = null;

  const replays = new Map(figures.map((figure) => [figure.querySelector(".stage"), new Replay(figure)]));
  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      const replay = replays.get(entry.target), busy = Replay.awake?.frame;
      if (entry.isIntersecting && !busy) { if (replay.wake()) replay.show(replay.now); }
      if (!entry.isIntersecting) replay.pause();
    }
  }, { threshold: 0.35 });
  const sized = new ResizeObserver((entries) => entries.forEach((entry) => replays.get(entry.target).resize()));
  for (const stage of replays.keys()) { seen.observe(stage); sized.observe(stage); }
  for (const query of ["(prefers-color-scheme: dark)", "print"]) {
    matchMedia(query).addEventListener("change", () => {
      for (const replay of replays.values()) if (replay.scene) { replay.dress(); replay.show(replay.now); }
    });
  }
})();
