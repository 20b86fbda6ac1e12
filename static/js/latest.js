// @ts-check
// Asking a server while somebody drags: one question at a time, and always the latest. Pure.

/**
 * @template Q, A
 * @param {(question: Q, signal: AbortSignal) => Promise<A>} ask
 * @param {{onAnswer: (answer: A, question: Q) => void, onError: (error: unknown) => void, onBusy?: (isBusy: boolean) => void}} told
 */
export function createLatest(ask, { onAnswer, onError, onBusy = () => {} }) {
  const stop = new AbortController();
  /** @type {{question: Q} | null} */
  let waiting = null;
  let isBusy = false;

  const work = async () => {
    isBusy = true;
    onBusy(true);
    while (waiting && !stop.signal.aborted) {
      const { question } = waiting;
      waiting = null;
      try {
        const answer = await ask(question, stop.signal);
        if (!stop.signal.aborted) onAnswer(answer, question);
      } catch (error) {
        if (!stop.signal.aborted) onError(error);
      }
    }
    isBusy = false;
    if (!stop.signal.aborted) onBusy(false);
  };

  return {
    /** What was asked before and has not been sent is forgotten. @param {Q} question */
    ask(question) {
      waiting = { question };
      if (!isBusy) void work();
    },

    stop: () => stop.abort(),
  };
}
