"""From evidence to verdicts, each with a reason and a sentence."""
