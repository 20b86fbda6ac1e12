// @ts-check
// Dark or light: the system's, unless a person has chosen.

/** @param {import("./prefs.js").PrefsValue} prefs */
export function watchTheme(prefs) {
  const root = document.documentElement;
  const apply = () => {
    const { theme } = prefs.get();
    if (theme === "system") delete root.dataset.theme;
    else root.dataset.theme = theme;
  };
  prefs.observe(apply);
  apply();
}

/** Run when colours may have changed. @param {import("./prefs.js").PrefsValue} prefs @param {() => void} run @returns {() => void} stop */
export function onThemeChange(prefs, run) {
  const system = matchMedia("(prefers-color-scheme: dark)");
  system.addEventListener("change", run);
  const stop = prefs.observe(run);
  return () => {
    system.removeEventListener("change", run);
    stop();
  };
}
