"use strict";
// A plot over time on a canvas: lines, bounds, a value under the pointer, lines that can be hidden.

const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#000000",
  "#8c564b", "#17becf", "#9467bd", "#bcbd22"];

class Plot {
  constructor(parent, told, windowS) {
    this.told = told;
    this.windowS = windowS;
    this.runs = [];
    this.hidden = new Set();
    this.pointer = null;
    const box = document.createElement("div");
    box.className = "plot";
    const title = document.createElement("h2");
    title.textContent = told.unit ? `${told.title} (${told.unit})` : told.title;
    this.canvas = document.createElement("canvas");
    this.lines = document.createElement("div");
    this.lines.className = "lines";
    box.append(title, this.canvas, this.lines);
    parent.append(box);
    this.box = box;
    told.series.forEach((name, index) => {
      const label = document.createElement("span");
      label.textContent = `▬ ${name}`;
      label.style.color = COLOURS[index % COLOURS.length];
      label.title = "hide or show";
      label.onclick = () => {
        this.hidden.has(index) ? this.hidden.delete(index) : this.hidden.add(index);
        label.classList.toggle("off", this.hidden.has(index));
        this.draw();
      };
      this.lines.append(label);
    });
    this.value = document.createElement("span");
    this.lines.append(this.value);
    this.canvas.onmousemove = (event) => { this.pointer = event.offsetX; this.draw(); };
    this.canvas.onmouseleave = () => { this.pointer = null; this.value.textContent = ""; this.draw(); };
  }

  add(run, times, series, anew) {
    let kept = this.runs[run];
    if (!kept || anew) kept = this.runs[run] = { t: [], v: this.told.series.map(() => []) };
    for (const t of times) kept.t.push(t);
    series.forEach((values, index) => { for (const v of values) kept.v[index].push(v); });
    const last = kept.t[kept.t.length - 1];
    let first = 0;
    while (first < kept.t.length && kept.t[first] < last - this.windowS) first += 1;
    if (first > 200) {
      kept.t.splice(0, first);
      for (const each of kept.v) each.splice(0, first);
    }
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    if (!width || !this.runs.length) return;
    if (this.canvas.width !== Math.round(width * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    const context = this.canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const end = Math.max(...this.runs.filter(Boolean).map((run) => run.t.length ? run.t[run.t.length - 1] : 0));
    const start = end - this.windowS;
    let low = Infinity, high = -Infinity;
    for (const run of this.runs) {
      if (!run) continue;
      run.v.forEach((values, index) => {
        if (this.hidden.has(index)) return;
        values.forEach((v, k) => { if (v !== null && run.t[k] >= start) { low = Math.min(low, v); high = Math.max(high, v); } });
      });
    }
    if (low > high) { low = 0; high = 1; }
    const span = high - low || Math.abs(high) || 1;
    // A bound is drawn into view where the values come near it.
    for (const bound of this.told.bounds) {
      if (bound > high && bound - high < 0.6 * span) high = bound;
      if (bound < low && low - bound < 0.6 * span) low = bound;
    }
    const pad = 0.06 * (high - low || span);
    low -= pad; high += pad;
    const left = 46, bottom = height - 14;
    const x = (t) => left + (t - start) / this.windowS * (width - left - 4);
    const y = (v) => 4 + (high - v) / (high - low) * (bottom - 4);
    context.font = "10px system-ui";
    context.strokeStyle = "#e3e6ea"; context.fillStyle = "#5b6673"; context.lineWidth = 1;
    for (let k = 0; k <= 3; k += 1) {
      const v = low + (high - low) * k / 3;
      context.beginPath(); context.moveTo(left, y(v)); context.lineTo(width, y(v)); context.stroke();
      context.fillText(Number(v.toPrecision(3)).toString(), 2, y(v) + 3);
    }
    for (let t = Math.ceil(start / 5) * 5; t <= end; t += 5) {
      if (t >= 0) context.fillText(`${t} s`, x(t) - 8, height - 2);
    }
    context.setLineDash([4, 3]); context.strokeStyle = "#b3261e";
    for (const bound of this.told.bounds) {
      if (bound < low || bound > high) continue;
      context.beginPath(); context.moveTo(left, y(bound)); context.lineTo(width, y(bound)); context.stroke();
    }
    context.setLineDash([]);
    context.save();
    context.beginPath(); context.rect(left, 0, width - left, bottom); context.clip();
    this.runs.forEach((run, number) => {
      if (!run) return;
      context.setLineDash(number ? [3, 2] : []);
      run.v.forEach((values, index) => {
        if (this.hidden.has(index)) return;
        context.strokeStyle = COLOURS[index % COLOURS.length];
        context.lineWidth = 1.3;
        context.beginPath();
        let pen = false;
        values.forEach((v, k) => {
          if (v === null || run.t[k] < start) { pen = false; return; }
          pen ? context.lineTo(x(run.t[k]), y(v)) : context.moveTo(x(run.t[k]), y(v));
          pen = true;
        });
        context.stroke();
      });
    });
    context.restore();
    context.setLineDash([]);
    if (this.pointer !== null && this.runs[0] && this.runs[0].t.length) this.#tell(context, start, width, left, bottom);
  }

  #tell(context, start, width, left, bottom) {
    const run = this.runs[0];
    const t = start + (this.pointer - left) / (width - left - 4) * this.windowS;
    let k = run.t.findIndex((each) => each >= t);
    if (k < 0) k = run.t.length - 1;
    context.strokeStyle = "#9aa3ad";
    context.beginPath(); context.moveTo(this.pointer, 4); context.lineTo(this.pointer, bottom); context.stroke();
    const values = run.v.map((each) => each[k] === null || each[k] === undefined ? "–" : Number(each[k].toPrecision(4)));
    this.value.textContent = `${run.t[k].toFixed(2)} s: ${values.join("  ")}`;
  }
}
