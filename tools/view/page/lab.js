"use strict";
// The lab: nodes to unplug, a force on the platform, and every kind of fault that it knows.

// A row for each node: of a CAN channel, or a slave of an EtherCAT segment by its place from 1.
function ofChannel(node) {
  return { channel: node.channel, node: node.node, device: node.device, plugged: node.plugged,
    state: node.plugged ? `${node.nmt} ${node.state || ""}` : "unplugged" };
}

function ofSegment(slave, faults) {
  const node = slave.slave + 1;
  const pulled = faults.some(({ fault }) => fault.kind === "unplug" && fault.channel === slave.channel && fault.node === node);
  const cut = slave.powered ? "cut off" : "no supply";
  return { channel: slave.channel, node, device: slave.device, plugged: !pulled,
    state: pulled ? "unplugged" : slave.reachable ? `${slave.state_name} ${slave.drive_state || ""}` : cut };
}

class LabPanel {
  constructor(ask) {
    this.ask = ask; // (request, then) sends one request to the lab
    this.kinds = {};
    this.byId = (id) => document.getElementById(id);
    this.byId("hide").onclick = () => this.inject({ kind: "tracker_hidden", duration: 5 });
    this.byId("clear").onclick = () => this.ask({ op: "clear" }, (reply) => this.say(reply, "cleared"));
    this.byId("kind").onchange = () => this.fields();
    this.byId("inject").onclick = () => this.injectForm();
    const push = this.byId("push");
    push.oninput = () => { this.byId("pushed").textContent = `${push.value} N`; };
    push.onchange = () => this.push();
    push.onpointerup = () => { push.value = 0; this.byId("pushed").textContent = "0 N"; };
    this.look();
    setInterval(() => this.look(), 1000);
    ask({ op: "kinds" }, (reply) => {
      if (!reply.ok) return;
      this.kinds = reply.kinds;
      for (const name of Object.keys(this.kinds)) {
        const option = document.createElement("option");
        option.value = option.textContent = name;
        this.byId("kind").append(option);
      }
      this.fields();
    });
  }

  push() {
    const force = Number(this.byId("push").value);
    if (force) this.inject({ kind: "load", force: [force, 0, 0], duration: 1.5, rise: 0.2 });
  }

  inject(fault) {
    this.ask({ op: "inject", fault }, (reply) => this.say(reply, `${fault.kind} injected`));
  }

  say(reply, done) {
    const line = this.byId("labreply");
    line.textContent = reply.ok ? done : reply.error;
    line.classList.toggle("refused", !reply.ok);
    this.look();
  }

  look() {
    if (!this.byId("lab").open) return;
    this.ask({ op: "get" }, (reply) => {
      if (!reply.ok) { this.say2(reply.error); return; }
      const active = reply.faults.map((each) => Object.entries(each).filter(([, v]) => v !== null)
        .map(([k, v]) => `${k} ${typeof v === "object" ? JSON.stringify(v) : v}`).join(", "));
      this.byId("active").textContent = active.join("; ") || "none";
      this.nodes([...reply.nodes.map(ofChannel), ...reply.slaves.map((slave) => ofSegment(slave, reply.faults))]);
    });
  }

  say2(text) { this.byId("active").textContent = text; }

  nodes(nodes) {
    const body = this.byId("nodes").tBodies[0];
    if (body.rows.length !== nodes.length) {
      body.replaceChildren();
      for (const node of nodes) {
        const row = body.insertRow();
        for (let k = 0; k < 3; k += 1) row.insertCell();
        const button = document.createElement("button");
        button.dataset.node = `${node.channel}/${node.node}`;
        row.insertCell().append(button);
      }
    }
    nodes.forEach((node, index) => {
      const row = body.rows[index];
      row.cells[0].textContent = `${node.channel} node ${node.node}`;
      row.cells[1].textContent = node.device || "";
      row.cells[2].textContent = node.state;
      const button = row.cells[3].firstChild;
      button.textContent = node.plugged ? "Unplug" : "Plug in";
      button.onclick = () => this.inject({
        kind: node.plugged ? "unplug" : "replug", channel: node.channel, node: node.node });
    });
  }

  fields() {
    const kind = this.kinds[this.byId("kind").value];
    if (!kind) return;
    this.byId("about").textContent = kind.about;
    const fields = this.byId("fields");
    fields.replaceChildren();
    for (const [name, field] of Object.entries(kind.fields)) {
      if (name === "at") continue;
      const label = document.createElement("label");
      label.textContent = `${name} `;
      const input = document.createElement("input");
      input.size = 8;
      input.dataset.name = name;
      input.dataset.type = field.type;
      input.placeholder = field.default === undefined ? field.type : JSON.stringify(field.default);
      input.title = field.about || "";
      if (field.required && (name === "channel" || name === "node") && kind.where.length) {
        const [channel, node] = kind.where[0].split("/");
        input.value = name === "channel" ? channel : node || "";
      }
      label.append(input);
      fields.append(label, " ");
    }
  }

  injectForm() {
    const fault = { kind: this.byId("kind").value };
    for (const input of this.byId("fields").querySelectorAll("input")) {
      const text = input.value.trim();
      if (!text) continue;
      const type = input.dataset.type;
      if (type === "string") fault[input.dataset.name] = text;
      else if (type === "boolean") fault[input.dataset.name] = text === "true";
      else if (type === "vector") fault[input.dataset.name] = text.split(/[ ,]+/).map(Number);
      else fault[input.dataset.name] = Number(text);
    }
    this.inject(fault);
  }
}
