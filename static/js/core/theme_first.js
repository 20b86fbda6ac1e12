// @ts-check
// Loaded before the first paint, so that a chosen theme does not flash.

try {
  const { theme } = JSON.parse(localStorage.getItem("unghost.prefs.v1") ?? "{}");
  if (theme === "light" || theme === "dark") document.documentElement.dataset.theme = theme;
} catch {
  // Unreadable preferences are no reason to show nothing.
}
