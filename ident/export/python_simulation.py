"""Text of the part of an exported Python or CasADi file that keeps the past of the inputs.

The text uses constants that `seatrial.ident.export.python.constants` writes. Its functions compute the inputs of a step
as `seatrial.ident.data.record.build_record` computes those of a row.
"""

NEEDED_FOR_PAST = {"ceil", "isfinite", "pi", "remainder"}  # names of ``math`` that `PAST` uses
# Functions that the exports to Python and to CasADi share
PAST = '''
def _line(start, end, dt, n, linear, keeps_mean):
    """Return the line that replaces an input from start to end [s], counted from the start of a step of dt [s].

    The line is given by its values at start and end. Each is a list of weights of the n newest values of the input.
    The first of these values is that of the step.
    """
    first, last = [0.0] * n, [0.0] * n
    edges = [start, *(k * dt for k in range(1 - n, 2) if start < k * dt < end), end]
    middle, length = (start + end) / 2, end - start

    def add(weights, time, share):
        """Add a share of the value of a linear input at a time. A value is reached at the end of its step."""
        age = min(max(1 - time / dt, 0.0), n - 1.0)
        k = min(int(age), n - 2)
        weights[k] += share * (1 - age + k)
        weights[k + 1] += share * (age - k)

    if linear:
        add(first, start, 1.0)
        if not keeps_mean:
            add(last, end, 1.0)
            return first, last
        for low, high in zip(edges, edges[1:]):
            add(last, (low + high) / 2, 2 * (high - low) / length)
        return first, [b - a for a, b in zip(first, last)]
    for low, high in zip(edges, edges[1:]):  # a held input: the line has its mean and its first moment
        k = int(min(max(1 - (low + high) / 2 / dt, 0.0), n - 1.0))
        share, tilt = (high - low) / length, 3 * ((high - middle) ** 2 - (low - middle) ** 2) / length**2
        first[k] += share - tilt
        last[k] += share + tilt
    return first, last


def _plan(dt, hold):
    """Return what a step of dt [s] needs: which inputs are linear, their numbers of values, and parts of the step.

    A part has a duration [s], and the line of each input: the index of its values, and the weights of these values at
    the start and at the end of the part.
    """
    if not (isfinite(dt) and dt > 0.0):
        raise ValueError(f"dt is {dt!r}: give a positive time in s")
    if hold not in (None, "zero", "linear"):
        raise ValueError(f"hold is {hold!r}: give 'zero', 'linear', or None for the hold of the fit")
    linear = [(hold or own) == "linear" for own in HOLDS]
    longest = [max([0.0, *(d for s, d in zip(SOURCES, DELAYS) if s == k)]) for k in range(len(HOLDS))]
    counts = [int(ceil(d / dt - 1e-9)) + (2 if straight else 1) for d, straight in zip(longest, linear)]
    n = int(ceil(dt / MAX_STEP - 1e-6)) if dt > 1.1 * MAX_STEP else 1
    parts = []
    for k in range(n):
        start, end, lines = dt * k / n, dt * (k + 1) / n, []
        for source, delay in zip(SOURCES, DELAYS):
            if source < 0:  # time or work, whose two values are those at the start and at the end of the step
                ends = [1 - start / dt, start / dt], [1 - end / dt, end / dt]
            else:
                about = counts[source], linear[source], _KEEPS_MEAN[source]
                ends = _line(start - delay, end - delay, dt, *about)
            lines.append((source, *([(i, w) for i, w in enumerate(weights) if w] for weights in ends)))
        parts.append((end - start, lines))
    return linear, counts, parts


def _with_past(inputs, past, linear):
    """Return the values of each physical input: that of the step, and the past values. Angles are unwrapped."""
    values = []
    for value, before, straight, angle in zip(inputs, past, linear, _ANGLES):
        if straight and angle:
            value = before[0] + remainder(value - before[0], 2 * pi)
        values.append([value, *before])
    return values


def _power(values, linear):
    """Return the mean power of the thrusters in a step, as the rate of the input `work`."""
    power = 0.0
    for k in _SHAFTS:
        power = power + (abs(values[k][0]) ** 3 + abs(values[k][1 if linear[k] else 0]) ** 3) / 2
    return power / WORK_UNIT


def _ends(lines, values):
    """Return the inputs of the equations at the start and at the end of a part of a step."""
    return [[sum(w * values[line[0]][i] for i, w in line[end]) for line in lines] for end in (1, 2)]
'''
SIMULATION = '''

class Simulation:
    """Simulation with a fixed step, which has one value for each physical input and keeps the past of the inputs.

    Parameters
    ----------
    dt : float
        Time of a step [s]. A step longer than MAX_STEP is divided.
    x : sequence of float, optional
        States at the start; zero by default.
    p : dict
        All parameters, for example {**P, "m_u": 40.0}.
    inputs : sequence of float, optional
        Physical inputs before the start, which were constant; zero by default.
    hold : "zero" or "linear", optional
        Physical inputs between their samples: constant from the start of a step, or on a straight line to the value
        that is reached at its end. By default the hold of the fit, HOLDS. st.simulate has the same option and the same
        default, but the inputs before its start are its first ones, and not zero. To repeat it with samples u[k] every
        dt, create Simulation(dt, inputs=u[0]). Then call step(u[k]), for "zero" with k = 0, 1, ..., and for "linear"
        with k = 1, 2, ...
    t, work : float
        Time [s] and work at the start; zero by default, as at the start of a log. TIME is that of the end of the data,
        after a change such as that of a payload.

    Attributes
    ----------
    x : list of float
        States now.
    t, work : float
        Time since the start [s], and the value of the input `work`.

    Raises
    ------
    ValueError
        If a parameter is unknown or missing, if a value is not a finite number, or if an input exceeds LIMITS. The
        methods check their values in the same way.
    """

    def __init__(self, dt, x=None, p=P, inputs=None, hold=None, t=0.0, work=0.0):
        _check_parameters(p)
        self.dt, self.p = dt, p
        self._linear, self._counts, self._parts = _plan(dt, hold)
        self.reset(x, inputs, t, work)

    def reset(self, x=None, inputs=None, t=0.0, work=0.0):
        """Start again, with these states, physical inputs before the start, time and work; zero by default."""
        before = _inputs(inputs)
        self.x, self.t, self.work = _numbers(x, STATES, "states"), _number("t", t), _number("work", work)
        self._latest, self._past = before, [[value] * (n - 1) for value, n in zip(before, self._counts)]

    def step(self, inputs):
        """Return the states after a step with these physical inputs, in the order of PHYSICAL_INPUTS."""
        inputs = _inputs(inputs)
        values = self._values(inputs)
        for duration, lines in self._parts:
            first, last = _ends(lines, values)
            self.x = _step_along(self.x, first, last, duration, self.p)
        self.work, self.t = values[-2][1], values[-1][1]
        self._latest, self._past = inputs, [v[:-1] for v in values[:-2]]
        return list(self.x)

    def inputs_now(self, inputs=None):
        """Return the inputs of f and h now, at the start of a step with these physical inputs; by default the last."""
        given = self._latest if inputs is None else _inputs(inputs)
        return _ends(self._parts[0][1], self._values(given))[0]

    def outputs(self, inputs=None):
        """Return the outputs now, at the start of a step with these physical inputs; the last ones by default."""
        return h(self.x, self.inputs_now(inputs), self.p)

    def _values(self, inputs):
        """Return the values of each physical input, newest first; then work and time before and after the step."""
        values = _with_past(inputs, self._past, self._linear)
        work = self.work + self.dt * _power(values, self._linear)
        return [*values, [self.work, work], [self.t, self.t + self.dt]]


def inputs_from(inputs, t=TIME, work=WORK):
    """Return the inputs u of f, h and step for physical inputs that are and were constant, in their order.

    A delayed input has the present value. The defaults of t and work are those of the end of the fitted data.
    """
    values = [*_inputs(inputs), _number("work", work), _number("t", t)]
    return [values[source] for source in SOURCES]


def _numbers(values, names, what):
    """Return the values as a list of finite floats, which are zero by default."""
    if values is None:
        return [0.0] * len(names)
    if isinstance(values, (dict, str)) or not hasattr(values, "__iter__"):
        raise ValueError(f"{what} is {values!r}: give a list of the numbers {', '.join(names)}")
    values = list(values)
    if len(values) != len(names):
        raise ValueError(f"{len(values)} {what}, but the model has {len(names)}: {', '.join(names)}")
    return [_number(name, value) for name, value in zip(names, values)]


def _number(name, value):
    """Return the value of a named quantity as a float; ValueError if it is not a finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = nan
    if not isfinite(number):
        raise ValueError(f"{name} is {value!r}: give a finite number")
    return number


def _inputs(values):
    """Return physical inputs as a list of floats, which are zero by default; ValueError if one exceeds LIMITS."""
    numbers = _numbers(values, PHYSICAL_INPUTS, "inputs")
    for name, number, limit in zip(PHYSICAL_INPUTS, numbers, LIMITS):
        if abs(number) > limit:
            raise ValueError(f"{name} is {number!r}: give -1 to 1, where 1 is full speed ahead")
    return numbers


def _check_parameters(p):
    """Raise ValueError if a parameter is unknown, missing or not a finite number."""
    for name in p:
        if name not in P:
            near = get_close_matches(str(name), P, 1)
            meant = f" Did you mean {near[0]}?" if near else ""
            raise ValueError(f"the model has no parameter {name!r}; it has {', '.join(P)}.{meant}")
    missing = [name for name in P if name not in p]
    if missing:
        raise ValueError(f"p lacks {', '.join(missing)}: give all parameters, as {{**P, 'NAME': value}}")
    for name, value in p.items():
        _number(name, value)


def _step_along(x, first, last, dt, p):
    """Return the states after dt [s], for inputs on a line from first to last: one step of Runge-Kutta 4."""
    middle = [(a + b) / 2 for a, b in zip(first, last)]
    k1 = f(x, first, p)
    k2 = f([a + dt / 2 * k for a, k in zip(x, k1)], middle, p)
    k3 = f([a + dt / 2 * k for a, k in zip(x, k2)], middle, p)
    k4 = f([a + dt * k for a, k in zip(x, k3)], last, p)
    return [a + dt / 6 * (b + 2 * c + 2 * d + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4)]
'''
