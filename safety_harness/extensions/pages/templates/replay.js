// Replays of runs in 3-D, drawn when they are looked at: until then the page holds them, and three.js, deflated.
// A renderer is lent to the replay that is looked at: one for the page, or one for each of two lanes that go in step.
(() => {
  const figures = [...document.querySelectorAll("figure.replay")];
  if (!figures.length) return;
  const quiet = matchMedia("(prefers-reduced-motion: reduce)");
  const NAN = -2147483648, INF = 2147483647;  // as packing.py has them
  const inflate = async (text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
  };
  const unpack = async ({ columns, packed }) => {
    const bytes = new Uint8Array(await inflate(packed)), size = bytes.length / 4, found = {};
    let at = 0;
    for (const [name, [rows, width, scale]] of Object.entries(columns)) {
      const values = (found[name] = new Float64Array(rows * width));
      for (let k = 0; k < width; k++) {
        for (let row = 0, sum = 0; row < rows; row++, at++) {
          sum = (sum + (bytes[at] | (bytes[size + at] << 8) | (bytes[2 * size + at] << 16) | (bytes[3 * size + at] << 24))) | 0;
          values[row * width + k] = sum === NAN ? NaN : sum === INF ? Infinity : sum / scale;
        }
      }
    }
    return found;
  };
  let library;
  const three = () => (library ??= inflate(THREE_DEFLATED).then((found) => {
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(found);
    document.head.append(script);
    script.remove();
  }));
  const read = async ({ dataset }) => JSON.parse(new TextDecoder().decode(await inflate(dataset.packed)));
  const inked = (name) => new THREE.Color(getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  const vector = (from) => new THREE.Vector3(...from);
  const save = (blob, name) => {
    const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  };
  const lanes = {};  // name to its renderer and the replay that has it

  class Replay {
    constructor(figure) {
      const part = (name) => figure.querySelector(name);
      this.figure = figure;
      this.lane = lanes[figure.dataset.lane] ??= {};
      this.shown = new Set([...figure.querySelectorAll("[data-layer][aria-pressed=true]")].map((one) => one.dataset.layer));
      for (const name of ["stage", "play", "scrub", "clock", "speed", "strip"]) this[name] = part(`.${name}`);
      this.says = part(".says-now");
      this.now = Number(figure.dataset.from);
      this.frame = 0;
      const on = (element, event, act) => element.addEventListener(event, (e) => this.load().then(() => act(e), () => this.fail()));
      const to = (time) => { this.pause(); this.go(time); };
      on(this.play, "click", () => (this.frame ? this.pause() : this.start()));
      on(this.scrub, "input", () => to(Number(this.scrub.value)));
      for (const jump of figure.querySelectorAll("[data-jump]")) on(jump, "click", () => to(Number(jump.dataset.jump)));
      for (const view of figure.querySelectorAll("[data-view]")) on(view, "click", async () => (await this.wake()) && this.look(view.dataset.view));
      for (const layer of figure.querySelectorAll("[data-layer]")) on(layer, "click", () => this.toggle(layer));
      for (const kind of figure.querySelectorAll("[data-save]")) on(kind, "click", async () => (await this.wake()) && this[kind.dataset.save]());
      this.stage.addEventListener("keydown", (event) => this.turn(event));
    }

    get mates() { return [...replays.values()].filter((one) => one !== this && this.figure.dataset.lane && one.data); }

    load() { return (this.loading ??= this.read()); }

    async read() {
      const data = await read(this.figure);
      this.columns = await unpack(data);
      this.times = this.columns.time_s;
      this.last = this.times[this.times.length - 1];
      this.data = data;
      if (data.meshes_of) ({ meshes: data.meshes } = await read(document.getElementById(data.meshes_of)));
      if (data.meshes) Object.assign(data.meshes, await unpack(data.meshes));
      if (data.chart) this.chart();
      this.show(this.now);
    }

    fail() {
      this.figure.dataset.state = "unavailable";
      this.stage.querySelector(".stage-note").textContent =
        "This browser shows no 3-D (WebGL is off or missing, or the browser is old). The drawings show the same run.";
    }

    async wake() {  // build the scene when it is first looked at, and take the lane's renderer
      const { lane } = this;
      if (lane.awake === this) return true;
      try {
        await Promise.all([three(), this.load()]);
        if (!lane.renderer) {
          lane.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, failIfMajorPerformanceCaveat: false });
          lane.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
          lane.renderer.domElement.setAttribute("aria-hidden", "true");
        }
        if (!this.scene) this.build();
        if (lane.awake && lane.awake !== this) { lane.awake.pause(); lane.awake.controls.enabled = false; }
        this.stage.prepend(lane.renderer.domElement);
        lane.awake = this;
        this.show(this.now);
        this.orbit();
        this.resize();
        if (!this.frame) this.figure.dataset.state = "ready";
        return true;
      } catch (error) {
        this.fail();
        return false;
      }
    }

    build() {
      const { data } = this;
      this.materials = {};
      this.scene = new THREE.Scene();
      this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8f94, 2.2));
      const sun = new THREE.DirectionalLight(0xffffff, 1.6);
      sun.position.set(1.5, -2, 3);
      this.scene.add(sun);
      this.camera = new THREE.PerspectiveCamera(38, 1, 0.02, 30);
      this.camera.up.set(0, 0, 1);
      const ink = (material, name) => { (this.materials[name] ??= []).push(material); return material; };
      const solid = (name, more = {}) => ink(new THREE.MeshLambertMaterial(more), name);
      const stroke = (name, more = {}) => ink(new THREE.LineBasicMaterial(more), name);
      const clear = (name, opacity) => ink(new THREE.MeshBasicMaterial({ transparent: true, opacity, depthWrite: false }), name);
      const line = (points, material, parent = this.scene, kind = THREE.Line) => {
        const one = new kind(new THREE.BufferGeometry().setFromPoints(points), material);
        parent.add(one);
        return one;
      };
      const ball = (radius, material, parent = this.scene) => {
        const one = new THREE.Mesh(new THREE.SphereGeometry(radius, 28, 18), material);
        parent.add(one);
        return one;
      };
      const capsule = (radius, length, material) => new THREE.Mesh(new THREE.CapsuleGeometry(radius, length, 8, 20), material);
      this.layers = {};
      for (const name of ["ways", "cameras", "critical", "separation"]) this.scene.add((this.layers[name] = new THREE.Group()));
      const { ways, cameras, critical, separation } = this.layers;
      // the table, the object on it and the boxes beside it
      const table = new THREE.GridHelper(2.4, 24, 0xffffff, 0xffffff);
      table.material = stroke("--fig-grid");
      table.rotation.x = Math.PI / 2;
      table.position.set(0.6, 0, data.table_height_m - 0.001);
      this.scene.add(table);
      for (const face of (data.boxes_in_base_m ?? []).flat()) line(face.map(vector), stroke("--fig-text"), this.scene, THREE.LineLoop);
      if (data.object_in_base_m) line(data.object_in_base_m.map(vector), stroke("--fig-object"), this.scene, THREE.LineLoop);
      // the arm: frame within frame, as its joints are
      const still = (rows, parent) => {
        const one = new THREE.Group();
        one.matrixAutoUpdate = false;
        one.matrix.set(...rows);
        parent.add(one);
        return one;
      };
      const links = [new THREE.Group()];
      this.scene.add(links[0]);
      this.joints = data.joint_origins.map((rows, k) => {
        const turned = new THREE.Group();
        still(rows, links[k]).add(turned);
        links.push(turned);
        return { turned, axis: vector(data.joint_axes[k]) };
      });
      this.tool = still(data.flange, links[this.joints.length]);
      links.push(this.tool);
      const meshed = new Set(data.meshes?.links);
      this.capsules = data.capsules.map((one) => {
        const start = vector(one.start), end = vector(one.end), covers = meshed.has(one.link);
        const body = capsule(one.radius_m, start.distanceTo(end), solid("--replay-arm", { transparent: true, opacity: covers ? 0.3 : 0.94, depthWrite: !covers }));
        along(body, start, end);
        links[one.link].add(body);
        return Object.assign(body, { covers });
      });
      for (const link of meshed) {
        const shape = new THREE.BufferGeometry();
        shape.setAttribute("position", new THREE.BufferAttribute(Float32Array.from(data.meshes[`corners ${link}`]), 3));
        shape.setIndex([...data.meshes[`faces ${link}`]]);
        links[link].add(new THREE.Mesh(shape, solid("--replay-arm", { side: THREE.DoubleSide, flatShading: true })));
      }
      // hands with forearms, where they are predicted, how far they have to be
      this.hands = data.hands.map((name, k) => {
        const forearm = capsule(data.forearm_radius_m, data.forearm_length_m, solid(`--fig-hand-${k + 1}`, { transparent: true, opacity: 0.55 }));
        this.scene.add(forearm);
        return { hand: ball(data.hand_radius_m, solid(`--fig-hand-${k + 1}`)), forearm, needs: ball(1, clear("--fig-limit", 0.1), separation) };
      });
      this.tracks = Array.from({ length: data.tracks ?? 0 }, () => {
        const mark = new THREE.Mesh(new THREE.SphereGeometry(1, 14, 10), ink(new THREE.MeshBasicMaterial({ wireframe: true, transparent: true, opacity: 0.4 }), "--fig-predicted"));
        mark.matrixAutoUpdate = false;
        this.scene.add(mark);
        return mark;
      });
      for (const { on_tool, transform, corners } of data.views ?? []) {
        const from = still(transform, on_tool ? this.tool : cameras), far = corners.map(vector);
        const edges = far.flatMap((corner) => [new THREE.Vector3(), corner]), seen = stroke("--fig-sky");
        line(edges, seen, from);
        line(far, seen, from, THREE.LineLoop);
        if (on_tool) this.view = Object.assign(from, { seen });
      }
      // the way of the TCP, the critical distance about it, the ways of the last decision
      if (data.critical_distance_m) {
        ball(data.critical_distance_m, clear("--fig-limit", 0.09), critical);
        const ring = Array.from({ length: 96 }, (_, k) => vector([Math.cos((k * Math.PI) / 48), Math.sin((k * Math.PI) / 48), 0].map((x) => x * data.critical_distance_m)));
        line(ring, stroke("--fig-limit", { transparent: true, opacity: 0.6 }), critical, THREE.LineLoop);
      }
      const tcp = this.columns.tcp_in_base_m ?? [], way = [];
      for (let k = 0; k < tcp.length; k += 3) way.push(vector(tcp.subarray(k, k + 3)));
      this.way = way.filter((at) => Number.isFinite(at.x));
      const path = new THREE.BufferGeometry().setFromPoints(this.way);
      path.computeBoundingSphere();
      line(this.way, stroke("--fig-muted", { transparent: true, opacity: 0.45 }), ways);
      this.travelled = line(way, stroke("--fig-tcp"), ways);
      this.travelled.geometry.boundingSphere = path.boundingSphere;
      this.decided = (data.decisions ?? []).map(({ from, chosen, refused }) => {
        const group = new THREE.Group();
        ways.add(group);
        for (const [end, name] of [[chosen, "--fig-chosen"], ...refused.map((one) => [one, "--fig-violated"])]) {
          if (!end) continue;
          const mark = new THREE.Mesh(new THREE.SphereGeometry(0.016, 4, 2), solid(name));
          mark.position.set(...end);
          group.add(mark);
          if (from) line([vector(from), vector(end)], stroke(name), group);
        }
        return group;
      });
      this.dress();
      const has = { capsules: meshed.size > 0, ways: way.length, cameras: data.views?.length, critical: data.critical_distance_m && way.length, separation: this.columns.separation_m?.some(Number.isFinite) && this.hands.length };
      for (const one of this.figure.querySelectorAll("[data-layer]")) {
        if (data.shows?.includes(one.dataset.layer)) this.toggle(one);
        one.hidden = !has[one.dataset.layer];
      }
      this.figure.querySelector("[data-save=webm]").hidden = !window.MediaRecorder;
    }

    dress() {  // the page's colours, light or dark
      for (const [name, own] of Object.entries(this.materials)) own.forEach((one) => one.color.copy(inked(name)));
      this.plain = inked("--replay-arm");
      this.marked = inked("--fig-tcp");
      this.views = [inked("--fig-limit"), inked("--fig-sky"), inked("--fig-muted")];
    }

    toggle(button) {
      const on = button.getAttribute("aria-pressed") !== "true", { layer } = button.dataset;
      button.setAttribute("aria-pressed", on);
      this.shown[on ? "add" : "delete"](layer);
      if (this.scene) this.show(this.now);
    }

    chart() {  // modes, distances, decisions, faults and worst moments below the picture; other drawings over time go along
      const { data, columns, times, strip } = this, first = times[0], span = this.last - first || 1;
      const x = (time) => (1000 * (time - first)) / span;
      const far = Math.max(0.1, Math.min(1, columns.hand_distance_m.filter(Number.isFinite).reduce((a, b) => Math.max(a, b), 0)));
      const y = (metres) => 60 - 42 * Math.max(-0.15, Math.min(1, metres / far));
      const spans = (column) => {  // [from, to, value] of equal ones in a row
        const found = [];
        column.forEach((value, k) => {
          if (k && value === column[k - 1]) found[found.length - 1][1] = times[k]; else { if (k) found[found.length - 1][1] = times[k]; found.push([times[k], times[k], value]); }
        });
        return found;
      };
      const parts = [];
      const put = (name, attributes) => parts.push(`<${name} ${Object.entries(attributes).map(([key, value]) => `${key}="${value}"`).join(" ")} vector-effect="non-scaling-stroke"/>`);
      const bar = ([from, to], top, height, fill) => put("rect", { x: x(from), width: Math.max(1, x(to) - x(from)), y: top, height, fill: `var(${fill})` });
      for (const one of spans(columns.mode)) bar(one, 0, 11, data.mode_inks[one[2]] ?? "--fig-missing");
      for (const one of spans(columns.faulty)) if (one[2]) bar(one, 65, 5, "--fig-limit");
      const rule = (height, ink, dash) => put("path", { d: `M0 ${height}H1000`, stroke: `var(${ink})`, "stroke-dasharray": dash });
      rule(y(0), "--fig-muted", "none");
      for (const limit of data.limits_m) rule(y(limit), "--fig-limit", "4 3");
      data.hands.forEach((_, hand) => {
        let d = "", pen = "M";
        for (let k = 0; k < times.length; k++) {
          const metres = columns.hand_distance_m[k * data.hands.length + hand];
          if (!Number.isFinite(metres)) { pen = "M"; continue; }
          d += `${pen}${x(times[k]).toFixed(1)} ${y(metres).toFixed(1)}`;
          pen = "L";
        }
        put("path", { d, fill: "none", stroke: `var(--fig-hand-${hand + 1})`, "stroke-width": 1.5 });
      });
      const upright = (time, ink, width, dash) => put("path", { d: `M${x(time)} 12V64`, stroke: `var(${ink})`, "stroke-width": width, "stroke-dasharray": dash });
      for (const { time_s } of data.decisions) upright(time_s, "--fig-chosen", 1.2, "none");
      for (const { time_s, violated } of data.worst) upright(time_s, violated ? "--fig-violated" : "--fig-muted", violated ? 2 : 1, violated ? "none" : "1 3");
      strip.innerHTML = parts.join("");  // numbers and names of colours only
      const [left, width, whole, end] = data.chart;
      this.charts = [{ svg: strip, x, time: (share) => first + share * span, height: 70 }];
      for (const svg of document.querySelectorAll(`svg[aria-labelledby^="${data.charts}"]`)) {
        const time = (share) => ((share * whole - left) / width) * end;
        this.charts.push({ svg, x: (at) => left + (width * at) / end, time, height: svg.viewBox.baseVal.height });
      }
      for (const chart of this.charts) {
        chart.now = chart.svg.appendChild(document.createElementNS(chart.svg.namespaceURI, "path"));
        chart.now.setAttribute("class", "now");
        chart.svg.dataset.scrubs = "";
        const scrub = (event) => {
          const box = chart.svg.getBoundingClientRect();
          this.pause();
          this.go(chart.time((event.clientX - box.left) / box.width));
        };
        chart.svg.addEventListener("pointerdown", scrub);
        chart.svg.addEventListener("pointermove", (event) => { if (event.buttons) scrub(event); });
      }
    }

    orbit() {
      this.controls?.dispose();
      const { domElement } = this.lane.renderer;
      this.controls = new THREE.OrbitControls(this.camera, domElement);
      this.controls.enablePan = false;
      this.controls.enableZoom = this.stage.contains(document.activeElement);
      this.controls.minDistance = 0.4;
      this.controls.maxDistance = 8;
      domElement.style.touchAction = "pan-y";  // a finger that moves up or down scrolls the page
      this.controls.addEventListener("change", () => { this.draw(); this.mates.forEach((one) => one.like(this)); });
      this.stage.onfocus = () => { this.controls.enableZoom = true; };
      this.stage.onblur = () => { this.controls.enableZoom = false; };
      this.look(this.seenFrom ?? "oblique");
    }

    like({ camera, controls }) {  // the same view, of two replays in step
      if (!this.controls || this.camera.position.distanceTo(camera.position) < 1e-6) return;
      this.camera.position.copy(camera.position);
      this.controls.target.copy(controls.target);
      this.controls.update();
    }

    look(seenFrom) {  // all of the arm and of the hands of now in view; obliquely so that neither hides the other
      this.seenFrom = seenFrom;
      this.scene.updateMatrixWorld(true);
      const places = this.joints.map(({ turned }) => new THREE.Vector3().setFromMatrixPosition(turned.matrixWorld));
      const tcp = new THREE.Vector3().setFromMatrixPosition(this.tool.matrixWorld), base = new THREE.Vector3();
      const hands = this.hands.filter(({ hand }) => hand.visible).map(({ hand }) => hand.position);
      const near = hands.filter((hand) => hand.distanceTo(tcp) < 1.5);
      const all = [base, tcp, ...places, ...near, ...this.way.filter((_, k) => k % 20 === 0)].filter((at) => Number.isFinite(at.x + at.y + at.z));
      const low = all.reduce((a, b) => a.clone().min(b), all[0]), high = all.reduce((a, b) => a.clone().max(b), all[0]);
      const centre = low.clone().add(high).multiplyScalar(0.5);
      const radius = Math.max(...all.map((at) => at.distanceTo(centre))) + 0.12;
      let from = { top: [0, -0.01, 1], side: [0, -1, 0.03], front: [1, 0, 0.08], oblique: [0.65, -0.65, 0.45] }[seenFrom];
      if (seenFrom === "oblique" && near.length) {
        const nearest = near.reduce((a, b) => (a.distanceTo(tcp) < b.distanceTo(tcp) ? a : b));
        const apart = nearest.clone().sub(tcp).normalize(), out = nearest.clone().setZ(0).normalize();
        const score = (one) => vector(one).normalize().dot(out) * 0.3 - Math.abs(vector(one).normalize().dot(apart));
        from = Array.from({ length: 12 }, (_, k) => [Math.cos((k * Math.PI) / 6), Math.sin((k * Math.PI) / 6), 0.5]).reduce((a, b) => (score(b) > score(a) ? b : a));
      }
      const half = Math.tan((this.camera.fov * Math.PI) / 360) * Math.min(1, this.camera.aspect);
      this.controls.target.copy(centre);
      this.camera.position.copy(centre).addScaledVector(vector(from).normalize(), (0.92 * radius) / Math.sin(Math.atan(half)));
      this.controls.update();
      this.figure.querySelectorAll("[data-view]").forEach((one) => one.setAttribute("aria-pressed", one.dataset.view === seenFrom));
      this.draw();
    }

    async turn(event) {
      const turns = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1], "+": [0, 0, 0.9], "=": [0, 0, 0.9], "-": [0, 0, 1.1] };
      const turned = turns[event.key], ends = { Home: 0, End: Infinity }[event.key];
      if (event.target !== this.stage || (event.key !== " " && !turned && ends === undefined)) return;
      event.preventDefault();
      if (event.key === " ") { this.play.click(); return; }
      if (!(await this.wake())) return;
      if (ends !== undefined) { this.pause(); this.go(ends); return; }
      const arm = this.camera.position.clone().sub(this.controls.target);
      const size = arm.length() * (turned[2] ?? 1), azimuth = Math.atan2(arm.y, arm.x) + turned[0] * 0.1;
      const height = Math.min(1.5, Math.max(-0.3, Math.atan2(arm.z, Math.hypot(arm.x, arm.y)) - turned[1] * 0.08));
      arm.set(Math.cos(azimuth) * Math.cos(height), Math.sin(azimuth) * Math.cos(height), Math.sin(height));
      this.camera.position.copy(this.controls.target).addScaledVector(arm, size);
      this.controls.update();
      this.draw();
    }

    resize() {
      const { clientWidth: width, clientHeight: height } = this.stage;
      if (!width || !height || this.lane.awake !== this) return;
      this.lane.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      this.look(this.seenFrom);
    }

    async start() {
      if (!(await this.wake()) || this.frame) return;
      const longest = Math.max(this.last, ...this.mates.map((one) => one.last));
      let going = this.now >= longest ? this.times[0] : this.now, before = performance.now();
      this.play.textContent = "Pause";
      this.figure.dataset.state = "playing";
      const step = (moment) => {
        going = Math.min(longest, going + (Number(this.speed.value) * (moment - before)) / 1000);
        before = moment;
        this.go(quiet.matches && going < longest ? Math.floor(2 * going) / 2 : going);  // with less motion: twice a second
        if (going >= longest) this.pause(); else this.frame = requestAnimationFrame(step);
      };
      this.frame = requestAnimationFrame(step);
    }

    pause() {
      cancelAnimationFrame(this.frame);
      this.frame = 0;
      this.play.textContent = "Play";
      if (this.figure.dataset.state === "playing") this.figure.dataset.state = "paused";
      if (this.film?.state === "recording") this.film.stop();
    }

    async png() {
      const { width, height } = this.lane.renderer.domElement, foot = Math.round(width / 24);
      const picture = Object.assign(document.createElement("canvas"), { width, height: height + foot }), pen = picture.getContext("2d");
      const style = getComputedStyle(document.documentElement);
      pen.fillStyle = style.getPropertyValue("--paper");
      pen.fillRect(0, 0, width, height + foot);
      this.draw();
      pen.drawImage(this.lane.renderer.domElement, 0, 0);
      pen.fillStyle = style.getPropertyValue("--text");
      pen.font = `${Math.round(foot * 0.45)}px sans-serif`;
      pen.fillText(`${this.data.name}, ${this.clock.textContent}: ${this.says.textContent}`, foot / 3, height + foot * 0.65, width - foot / 1.5);
      picture.toBlob((blob) => save(blob, `${this.data.name}-${this.now.toFixed(3)}s.png`));
    }

    webm() {  // the run from its beginning, as it plays; a pause ends it
      const parts = [], film = new MediaRecorder(this.lane.renderer.domElement.captureStream(30), { mimeType: "video/webm" });
      this.pause();
      this.scene.background = inked("--paper");
      film.ondataavailable = ({ data }) => parts.push(data);
      film.onstop = () => { this.scene.background = null; this.draw(); save(new Blob(parts, { type: "video/webm" }), `${this.data.name}.webm`); };
      this.film = film;
      this.go(this.times[0]);
      film.start();
      this.start();
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
        found.push(a === b ? x : x + share * (y - x));
      }
      return found;
    }

    go(time) { for (const one of [this, ...this.mates]) one.show(time); }

    show(wanted) {
      const { data, columns } = this, time = Math.min(this.last, Math.max(this.times[0], wanted));
      this.now = time;
      this.scrub.value = time;
      this.figure.dataset.time = time.toFixed(3);
      const moment = this.at(time), tick = moment[2] > 0.5 ? moment[1] : moment[0];
      this.clock.textContent = `${time.toFixed(2)} s`;
      const parts = [data.modes[columns.mode[tick]], ...data.hands.map((name, k) => {
        const distance = columns.hand_distance_m[tick * data.hands.length + k];
        const far = Number.isFinite(distance) ? `${(distance * 1000).toFixed(0)} mm` : Number.isNaN(distance) ? data.lacking : "absent";
        return `${name} ${far}`.replace("-", "\u2212");
      })];
      this.decision = (data.decisions ?? []).findLastIndex((one) => one.time_s <= time + 1e-6);
      if (this.decision >= 0) parts.push(`decision ${this.decision + 1} at ${data.decisions[this.decision].time_s.toFixed(2)} s: ${data.decisions[this.decision].says}`);
      if (columns.faulty?.[tick]) parts.push("a fault acts");
      this.says.textContent = parts.join(" \u00b7 ");
      this.scrub.setAttribute("aria-valuetext", `${time.toFixed(2)} seconds, ${parts.join(", ")}`);
      for (const chart of this.charts ?? []) chart.now.setAttribute("d", `M${chart.x(time).toFixed(2)} 0V${chart.height}`);
      if (this.scene) { this.pose(moment); this.draw(); }
    }

    pose(moment) {
      const tick = moment[0], { data, columns, shown } = this, count = data.hands.length;
      const angles = this.between("joint_position_rad", this.joints.length, moment);
      this.joints.forEach(({ turned, axis }, k) => turned.quaternion.setFromAxisAngle(axis, angles[k]));
      for (const [name, group] of Object.entries(this.layers)) group.visible = shown.has(name);
      if (columns.tcp_in_base_m) this.layers.critical.position.set(...this.between("tcp_in_base_m", 3, moment));
      this.travelled.geometry.setDrawRange(0, tick + 1);
      for (const one of this.capsules) {
        one.visible = !one.covers || shown.has("capsules");
        one.material.color.copy(data.shows ? this.marked : this.plain);
      }
      if (this.view) {
        this.view.visible = shown.has("cameras");
        this.view.seen.color.copy(this.views[columns.object_visible[tick]] ?? this.views[2]);
      }
      this.hands.forEach(({ hand, forearm, needs }, k) => {
        const nearest = columns.nearest_capsule[tick * count + k], here = nearest >= 0;
        for (const one of [hand, forearm, needs]) one.visible = here;
        if (!here) return;
        const start = vector(this.between("hand_in_base_m", 3 * count, moment, 3 * k, 3));
        const elbow = vector(this.between("elbow_in_base_m", 3 * count, moment, 3 * k, 3));
        hand.position.copy(start);
        const way = elbow.sub(start), needed = columns.separation_m[tick];
        forearm.visible = way.lengthSq() > 0;
        along(forearm, start, start.clone().addScaledVector(way.normalize(), data.forearm_length_m));
        needs.visible = Number.isFinite(needed);
        needs.position.copy(start);
        needs.scale.setScalar(data.hand_radius_m + (needed || 0));
        const one = this.capsules[nearest];
        if (one) { one.visible = true; one.material.color.copy(this.marked); }
      });
      this.tracks.forEach((mark, k) => {
        const place = tick * data.tracks + k, [x, y, z] = columns.predicted_in_base_m.subarray(3 * place, 3 * place + 3);
        const [a, b, c, d, e, f] = columns.spread_m.subarray(6 * place, 6 * place + 6).map((one) => (2 * one) || 0), r = data.hand_radius_m;
        mark.visible = Number.isFinite(x);
        mark.matrix.set(a + r, b, c, x, b, d + r, e, y, c, e, f + r, z, 0, 0, 0, 1);
      });
      this.decided.forEach((group, k) => { group.visible = k === this.decision; });
    }

    draw() {
      if (this.lane.awake !== this || !this.scene) return;
      this.lane.renderer.render(this.scene, this.camera);
      const reached = new THREE.Vector3().setFromMatrixPosition(this.tool.matrixWorld);
      this.figure.dataset.tcp = reached.toArray().map((value) => value.toFixed(4)).join(" ");
      this.figure.dataset.triangles = this.lane.renderer.info.render.triangles;
    }
  }

  const along = (mesh, start, end) => {  // a capsule between two points
    const way = end.clone().sub(start);
    mesh.position.copy(start).addScaledVector(way, 0.5);
    if (way.lengthSq() > 0) mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), way.normalize());
  };
  const replays = new Map();
  figures.forEach((figure) => replays.set(figure.querySelector(".stage"), new Replay(figure)));
  const seen = new IntersectionObserver((entries) => {
    for (const { target, intersectionRatio } of entries) {
      const replay = replays.get(target);
      if (intersectionRatio >= 0.35 && !replay.lane.awake?.frame) replay.wake();
      if (intersectionRatio === 0 && replay.data) replay.pause();
    }
  }, { threshold: [0, 0.35] });
  const sized = new ResizeObserver((entries) => entries.forEach((entry) => replays.get(entry.target).resize()));
  for (const stage of replays.keys()) { seen.observe(stage); sized.observe(stage); }
  for (const query of ["(prefers-color-scheme: dark)", "print"]) {
    matchMedia(query).addEventListener("change", () => {
      for (const replay of replays.values()) if (replay.scene) { replay.dress(); replay.show(replay.now); }
    });
  }
})();
