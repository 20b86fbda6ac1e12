"""HTTP code that all routes share: access, bodies, files, pages and problems."""
