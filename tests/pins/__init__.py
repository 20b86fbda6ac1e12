"""Pins: values that must not change when code is rearranged.

They are stored bytes, digests, answers and names. Each pin computes a value from the
present code and compares it with a file in ``stored/`` that was written by an earlier
version. A failure names the place that differs, with both values. No pin says that a
value is right, only that it is the same as before; the other tests check that it is
right.

These commands rewrite the files:

    python -m tests.pins.write            # all of them
    python -m tests.pins.write openapi    # some, by name

Do that only if users are meant to see the difference, and add a line to CHANGELOG.md;
never to make a mere rearrangement of code pass.

What each file holds, and what of it is replaced because it differs from run to run:

* ``digests``: configurations, and what is measured by, as stored in the database.
* ``records``: evidence and flips as bytes, of fixed arrays in the module `records`.
* ``rows``: evidence and flips as the service stores them for the frames of `street`.
* ``exports``: every format, each file of the archive by its SHA-256. Times in
  ``manifest.json`` are replaced; Parquet is compared by its rows and its schema, since
  its bytes name the version of the library that wrote them.
* ``demo``: the first frame of ``unghost demo`` in every format, in the same way. The
  copied image is only compared with the one that was rendered.
* ``openapi``: the OpenAPI document. FastAPI and pydantic generate parts of it, so a new
  version of them may change it without a change of our code.
* ``routes``: every route in the order in which they are tried.
* ``decisions``: the keys of a decision in their order, wherever one is written.
* ``names``: what `filter_core` and `unghost` offer, and what documents import.
* ``modules``: which packages of others an import loads, and the largest number of our
  own modules that it may load.
* ``responses``: every response of a walk over the API. Times, secrets, ids of requests
  and the version are replaced; of drawn pictures, the size is kept and not the pixels.
  Counts by class or reason are sorted, since databases have no order for them.
* ``command_line``: what ``unghost filter --json`` prints.
"""
