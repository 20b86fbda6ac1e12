"""What every route shares: who may call, bodies, files, pages, problems."""
