// A click, or Enter, on what a mode displayed shows the reference in its place and back again.
document.documentElement.classList.add("scripted");
for (const set of document.querySelectorAll(".set")) {
  const reference = set.querySelector("img.reference");
  for (const shown of set.querySelectorAll("img.mode")) {
    const own = { src: shown.src, alt: shown.alt };
    const toggle = () => {
      const swapped = shown.classList.toggle("swapped");
      shown.src = swapped ? reference.src : own.src;
      shown.alt = swapped ? reference.alt : own.alt;
      shown.setAttribute("aria-pressed", swapped);
    };
    shown.tabIndex = 0;
    shown.setAttribute("role", "button");
    shown.setAttribute("aria-pressed", false);
    shown.addEventListener("click", toggle);
    shown.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") {
        event.preventDefault();
        toggle();
      }
    });
  }
}
