// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// Files that are dropped or chosen go to the demo one by one; what it says comes into their place.

const pictures = {
  token: null,
  largest: Infinity, // bytes

  // Called by the page when its elements are there.
  start(token, largest) {
    Object.assign(this, { token, largest });
    for (const slot of document.querySelectorAll(".slot")) {
      const input = slot.querySelector("input");
      input.addEventListener("change", () => {
        this.take([...input.files], slot.dataset.slot);
        input.value = "";
      });
      for (const kind of ["dragenter", "dragover"])
        slot.addEventListener(kind, (event) => this.hover(event, slot, true));
      slot.addEventListener("dragleave", (event) => this.hover(event, slot, false));
      slot.addEventListener("drop", (event) => {
        this.hover(event, slot, false);
        this.take([...event.dataTransfer.files], slot.dataset.slot);
      });
    }
    // A file that misses its place does not replace the page.
    for (const kind of ["dragover", "drop"]) window.addEventListener(kind, (event) => event.preventDefault());
  },

  hover(event, slot, inside) {
    event.preventDefault();
    slot.classList.toggle("hovered", inside);
  },

  // Two files at once are the first and the second picture, wherever they are dropped.
  take(files, slot) {
    if (slot === "lens" || files.length === 1) {
      if (files.length) this.send(files[0], slot);
      return;
    }
    for (const [k, file] of files.slice(0, 2).entries()) this.send(file, String(k + 1));
  },

  async send(file, slot) {
    if (file.size > this.largest) {
      this.problem(slot, `${file.name} is larger than ${Math.round(this.largest / 2 ** 20)} MB, the limit.`);
      fetch(`/pictures/${this.token}/${slot}`, { method: "DELETE" }).catch(() => {});
      return;
    }
    this.say(slot, `Sending ${file.name} …`);
    try {
      const answer = await fetch(`/pictures/${this.token}/${slot}?name=${encodeURIComponent(file.name)}`, {
        method: "PUT", body: file, headers: { "Content-Type": "application/octet-stream" } });
      const { sentence } = await answer.json();
      if (sentence) this.problem(slot, sentence);
      else this.show(slot, URL.createObjectURL(file), file.name);
    } catch {
      this.problem(slot, `${file.name} did not arrive: the demo ended the transfer, or is not running.`);
    }
  },

  parts(slot) {
    const element = document.querySelector(`.slot[data-slot="${slot}"]`);
    return { element, image: element.querySelector("img"), words: element.querySelector(".words") };
  },

  say(slot, text) {
    const { element, image, words } = this.parts(slot);
    element.classList.remove("filled", "wrong");
    if (image) image.removeAttribute("src");
    words.textContent = text;
  },

  problem(slot, sentence) {
    this.say(slot, sentence);
    this.parts(slot).element.classList.add("wrong");
  },

  show(slot, address, name) {
    this.say(slot, name);
    const { element, image } = this.parts(slot);
    element.classList.add("filled");
    if (image) image.src = address;
  },

  clear() {
    for (const { dataset } of document.querySelectorAll(".slot"))
      this.say(dataset.slot, this.parts(dataset.slot).words.dataset.empty);
  },
};

// The report of the pair stands in a frame without its own scroll bar, and without its verdict,
// which stands above it.
function fitReport(frame) {
  const page = frame.contentDocument;
  if (!page || !page.querySelector("main")) return;
  const style = page.createElement("style");
  style.textContent = "h1, .names, section.verdict { display: none } main, footer { padding: 0 !important }";
  page.head.append(style);
  const fit = () => { frame.style.height = `${page.documentElement.getBoundingClientRect().height}px`; };
  new frame.contentWindow.ResizeObserver(fit).observe(page.documentElement);
  fit();
}
