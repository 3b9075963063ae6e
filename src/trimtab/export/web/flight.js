// Flight in a page: set the parameters by sliders, simulate the run, and draw it over the run with the original values.
(() => {
  const root = document.currentScript.parentElement;
  const about = JSON.parse(root.querySelector("script[type='application/json']").textContent);
  const MARGIN = { left: 56, right: 8, top: 8, bottom: 18 };

  const decode = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

  function build(name, attributes, ...children) {
    const element = Object.assign(document.createElement(name), attributes);
    element.append(...children);
    return element;
  }

  /** Return the slider's value at which the parameters have their original values. */
  const ownValue = (program, slider) => (slider.adds ? 0 : program.get(...slider.which[0].slice(0, 2)));

  /** Simulate a flight with these values, one per slider. Return all outputs of all instants, and the duration (ms). */
  function fly(program, values, seed) {
    program.defaults();
    about.sliders.forEach((slider, n) => {
      for (const [which, first, end] of slider.which) {
        for (let i = first; i < end; i++) {
          program.set(which, i, slider.adds ? program.get(which, i) + values[n] : values[n]);
        }
      }
    });
    program.set(about.seed.which, 0, seed);
    const began = performance.now();
    const at = program.fly();
    const took = performance.now() - began;
    return { rows: new Float64Array(program.memory.buffer, at, about.instants * about.names.length), took };
  }

  const reference = new Float64Array(decode(about.reference.rows).buffer);

  /** Count the numbers that differ in any bit from those of trimtab run; two NaNs are equal. */
  function countDifferences(rows) {
    const columns = about.signals.map((signal) => about.names.indexOf(signal.path));
    let others = 0;
    reference.forEach((wanted, n) => {
      const row = Math.floor(n / columns.length) * about.reference.every;
      others += !Object.is(rows[row * about.names.length + columns[n % columns.length]], wanted);
    });
    return others;
  }

  /** Return the limits of an axis that shows all finite numbers of these lists, with some margin. */
  function findLimits(lists) {
    let [low, high] = [Infinity, -Infinity];
    for (const list of lists) for (const y of list) if (Number.isFinite(y)) [low, high] = [Math.min(low, y), Math.max(high, y)];
    if (!(low <= high)) return [-1, 1];
    const room = 0.06 * (high - low) || 0.5;
    return [low - room, high + room];
  }

  /** Return three to six round numbers between these limits. */
  function findTicks(low, high) {
    const rough = (high - low) / 4;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
    const first = Math.ceil(low / step);
    return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, k) => (first + k) * step);
  }

  function draw(canvas, signal, number, rows) {
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    [canvas.width, canvas.height] = [Math.round(width * scale), Math.round(height * scale)];
    const pen = canvas.getContext("2d");
    pen.scale(scale, scale);
    const column = about.names.indexOf(signal.path);
    const now = Array.from({ length: about.instants }, (_, k) => rows[k * about.names.length + column]);
    const before = Array.from({ length: reference.length / about.signals.length }, (_, k) => reference[k * about.signals.length + number]);
    const [low, high] = findLimits([now, before, signal.target === null ? [] : [signal.target]]);
    const x = (k) => MARGIN.left + ((width - MARGIN.left - MARGIN.right) * k) / about.instants;
    const y = (value) => MARGIN.top + ((height - MARGIN.top - MARGIN.bottom) * (high - value)) / (high - low);
    const style = getComputedStyle(root);
    pen.fillStyle = style.color;
    pen.font = "11px sans-serif";
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    for (const value of findTicks(low, high)) {
      pen.globalAlpha = 0.2;
      pen.fillRect(MARGIN.left, Math.round(y(value)), width - MARGIN.left - MARGIN.right, 1);
      pen.globalAlpha = 1;
      pen.fillText(String(Number(value.toPrecision(3))), MARGIN.left - 5, y(value));
    }
    pen.textAlign = "center";
    for (let part = 0; part <= 5; part++) {
      const text = `${Number(((about.duration_s * part) / 5).toPrecision(3))}${part === 5 ? " s" : ""}`;
      pen.fillText(text, Math.min(x((about.instants * part) / 5), width - 14), height - 8);
    }
    const trace = (values, every, colour, thickness) => {
      pen.strokeStyle = style.getPropertyValue(colour);
      pen.lineWidth = thickness;
      pen.beginPath();
      let open = false;
      values.forEach((value, k) => {
        if (Number.isFinite(value)) open ? pen.lineTo(x(k * every), y(value)) : pen.moveTo(x(k * every), y(value));
        open = Number.isFinite(value);
      });
      pen.stroke();
    };
    if (signal.target !== null) {
      pen.setLineDash([4, 4]);
      trace([signal.target, signal.target], about.instants, "--goal", 1);
      pen.setLineDash([]);
    }
    trace(before, about.reference.every, "--before", 2);
    trace(now, 1, "--line", 1.3);
  }

  function buildSlider(program, slider, n) {
    const id = `flight-${Math.random().toString(36).slice(2)}-${n}`;
    const own = ownValue(program, slider);
    const input = build("input", { id, type: "range", min: slider.low, max: slider.high, step: "any" });
    input.value = own;
    const shown = build("output", { htmlFor: id });
    const label = build("label", { htmlFor: id, textContent: slider.name, title: slider.paths.join(", ") });
    return { slider, own, input, shown, label };
  }

  WebAssembly.instantiate(decode(about.program), {}).then(({ instance }) => {
    const program = instance.exports;
    program.defaults();
    const sliders = about.sliders.map((slider, n) => buildSlider(program, slider, n));
    const seed = build("input", { type: "number", min: 0, max: 4294967295, step: 1, value: about.seed.value, ariaLabel: "seed" });
    const back = build("button", { type: "button", textContent: "as shipped" });
    const form = build("form", {}, ...sliders.flatMap((s) => [s.label, s.input, s.shown]));
    form.append(build("span", { textContent: "seed of the noise" }), seed, back);
    const said = build("p", { role: "status" });
    const plots = about.signals.map((signal) => {
      const canvas = build("canvas", { ariaLabel: `${signal.path} over time` });
      canvas.setAttribute("role", "img");
      const caption = build("figcaption", { textContent: `${signal.path}${signal.unit ? `, ${signal.unit}` : ""}` });
      return { canvas, figure: build("figure", { title: signal.meaning }, caption, canvas) };
    });
    root.append(form, said, ...plots.map((p) => p.figure));

    function update() {
      const values = sliders.map((s) => Number(s.input.value));
      const number = Math.min(4294967295, Math.max(0, Math.floor(Number(seed.value)) || 0));
      const { rows, took } = fly(program, values, number);
      sliders.forEach((s, n) => (s.shown.value = `${Number(values[n].toPrecision(3))} ${s.slider.unit}`.trim()));
      plots.forEach((p, n) => draw(p.canvas, about.signals[n], n, rows));
      const shipped = number === about.seed.value && sliders.every((s, n) => values[n] === s.own);
      const others = shipped ? countDifferences(rows) : 0;
      const verdict = others ? `${others} of ${reference.length} numbers differ from trimtab run` : "the same bits as trimtab run";
      said.textContent =
        `${about.duration_s} s of flight, ${about.instants} steps, in ${took.toFixed(0)} ms. ` +
        (shipped ? `As shipped: ${verdict}.` : "Grey: as shipped. Dashed: target.");
      root.flight = { rows, took, values, seed: number, names: about.names, shipped, others };
    }

    let waiting = false;
    const later = () => {
      if (!waiting) requestAnimationFrame(() => ((waiting = false), update()));
      waiting = true;
    };
    back.onclick = () => {
      for (const s of sliders) s.input.value = s.own;
      seed.value = about.seed.value;
      later();
    };
    form.onsubmit = (event) => event.preventDefault();
    form.addEventListener("input", later);
    window.addEventListener("resize", later);
    update();
  });
})();
