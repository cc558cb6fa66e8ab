"use strict";
// Sliders between the photo and the re-rendered result.
for (const compare of document.querySelectorAll(".compare")) {
  const over = compare.querySelector(".over");
  const slider = compare.querySelector("input");
  const show = () => { over.style.clipPath = `inset(0 0 0 ${100 - slider.value}%)`; };
  slider.addEventListener("input", show);
  show();
}
