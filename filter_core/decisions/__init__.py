"""Evidence becomes verdicts, with a reason and a sentence."""
