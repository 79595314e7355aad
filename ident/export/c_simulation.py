"""Text of the part of an exported C header that keeps the past of the inputs in a ring buffer of fixed size.

The functions compute the inputs of a step as `seatrial.ident.data.record.build_record` computes those of a row. NAME is
the prefix of the model. `seatrial.ident.export.c` writes the constants before this text.
"""

SIMULATION = """
/* Inputs u of NAME_f, NAME_h and NAME_step for physical inputs that are and were constant.
   A delayed input has the present value. Time and work are NAME_TIME and NAME_WORK. */
static inline void NAME_inputs(const double inputs[], double u[])
{
    int i;
    for (i = 0; i < NAME_NU; i++)
        u[i] = NAME_source[i] == -1 ? NAME_TIME : NAME_source[i] == -2 ? NAME_WORK : inputs[NAME_source[i]];
}

/* Simulation with one value for each physical input. It keeps the past of the inputs in a ring buffer.
   The shortest step sets the size of the buffer. Define another value before you include this file. */
#ifndef NAME_SHORTEST_DT_US
#define NAME_SHORTEST_DT_US 10000 /* microseconds */
#endif
/* Define it as 1 to accept shorter steps, too. The past then keeps the mean of an input over the shortest step. */
#ifndef NAME_MERGE_SHORT_STEPS
#define NAME_MERGE_SHORT_STEPS 0
#endif
enum {
    NAME_HISTORY = (NAME_LONGEST_DELAY_US + NAME_SHORTEST_DT_US - 1) / NAME_SHORTEST_DT_US + 1 /* steps kept */
        + NAME_MERGE_SHORT_STEPS,
    NAME_OK = 0,
    NAME_DT_TOO_SHORT = 1, /* shorter than NAME_SHORTEST_DT_US, or not a number */
    NAME_DT_TOO_LONG = 2 /* longer than 1000 s */
};

typedef struct {
    double x[NAME_NX]; /* states now */
    double t; /* time since the start [s] */
    double work; /* value of the input work */
    const double *p; /* parameters; the array must exist as long as the simulation */
    int linear[NAME_NIN > 0 ? NAME_NIN : 1]; /* 1: an input is on a line to the value at the end of a step; 0: held */
    double value[NAME_HISTORY][NAME_NIN > 0 ? NAME_NIN : 1]; /* past values of the physical inputs */
    double length[NAME_HISTORY]; /* durations of their steps [s] */
    int newest; /* index of the last step */
} NAME_simulation;

/* Start at time zero with the states x, and with physical inputs that were constant before.
   A null pointer for x or inputs means zeros, and for p NAME_parameters.
   For another start, set sim->t and sim->work after it, for example to NAME_TIME and NAME_WORK. */
static inline void NAME_init(NAME_simulation *sim, const double x[], const double inputs[], const double p[])
{
    int i, k;
    for (i = 0; i < NAME_NX; i++) sim->x[i] = x ? x[i] : 0.0;
    sim->t = 0.0;
    sim->work = 0.0;
    sim->p = p ? p : NAME_parameters;
    sim->newest = 0;
    for (k = 0; k < NAME_HISTORY; k++) sim->length[k] = 1.0;
    for (i = 0; i < NAME_NIN; i++) {
        sim->linear[i] = NAME_linear[i];
        for (k = 0; k < NAME_HISTORY; k++) sim->value[k][i] = inputs ? inputs[i] : 0.0;
    }
}

/* Inputs of a step, which continue the angles of the past without a jump. */
static inline void NAME_present(const NAME_simulation *sim, const double inputs[], double now[])
{
    int i;
    for (i = 0; i < NAME_NIN; i++) {
        const double before = sim->value[sim->newest][i];
        now[i] = inputs[i];
        if (sim->linear[i] && NAME_angle[i]) now[i] = before + remainder(now[i] - before, 6.283185307179586);
    }
}

/* Rate of the input work in a step. */
static inline double NAME_power(const NAME_simulation *sim, const double now[])
{
    double power = 0.0;
    int i;
    for (i = 0; i < NAME_NIN; i++) {
        const double end = fabs(now[i]), start = sim->linear[i] ? fabs(sim->value[sim->newest][i]) : end;
        if (NAME_shaft[i]) power += (end * end * end + start * start * start) / 2.0;
    }
    return power / NAME_WORK_UNIT;
}

/* Line that replaces the input i of u from at to to [s], counted from the start of a step of dt [s]. */
static inline void NAME_line(const NAME_simulation *sim, const double now[], double dt, int i, double at, double to,
    double *first, double *last)
{
    const int k = NAME_source[i], linear = sim->linear[k];
    const double from = at - NAME_delay[i], until = to - NAME_delay[i], span = until - from;
    const double middle = (from + until) / 2.0;
    double end = dt, mean = 0.0, tilt = 0.0, value_from = now[k], value_until = now[k];
    int j;
    if (until > dt) { /* a later value is not known: it is taken as equal to the present one */
        const double low = from > dt ? from : dt;
        mean = (until - low) / span * now[k];
        tilt = 3.0 * ((until - middle) * (until - middle) - (low - middle) * (low - middle)) / (span * span) * now[k];
    }
    for (j = 0; j <= NAME_HISTORY && end > from; j++) { /* from the present step back to the oldest one */
        const int own = (sim->newest - j + 1 + NAME_HISTORY) % NAME_HISTORY;
        const int earlier = (sim->newest - j + NAME_HISTORY) % NAME_HISTORY;
        const int oldest = j == NAME_HISTORY;
        const double at_end = j ? sim->value[own][k] : now[k];
        const double at_start = linear && !oldest ? sim->value[earlier][k] : at_end;
        const double length = j ? sim->length[own] : dt, start = end - length;
        const double low = oldest || from > start ? from : start, high = until < end ? until : end;
        if (until >= low && until <= end) value_until = at_start + (at_end - at_start) * (until - start) / length;
        if (high > low) {
            const double value = at_start + (at_end - at_start) * ((low + high) / 2.0 - start) / length;
            mean += (high - low) / span * value;
            tilt += 3.0 * ((high - middle) * (high - middle) - (low - middle) * (low - middle)) / (span * span) * value;
        }
        value_from = at_start + (at_end - at_start) * (low - start) / length;
        end = start;
    }
    *first = linear ? value_from : mean - tilt;
    *last = !linear ? mean + tilt : NAME_keeps_mean[k] ? 2.0 * mean - value_from : value_until;
}

/* Inputs u of the equations, on lines from at to to [s] after the start of a step of dt [s]. */
static inline void NAME_ends(const NAME_simulation *sim, const double now[], double dt, double at, double to,
    double first[], double last[])
{
    const double power = NAME_power(sim, now);
    int i;
    for (i = 0; i < NAME_NU; i++) {
        if (NAME_source[i] == -1) {
            first[i] = sim->t + at;
            last[i] = sim->t + to;
        } else if (NAME_source[i] == -2) {
            first[i] = sim->work + power * at;
            last[i] = sim->work + power * to;
        } else {
            NAME_line(sim, now, dt, i, at, to, &first[i], &last[i]);
        }
    }
}

/* Whether a duration of dt [s] is shorter than the shortest step, or not a number. */
static inline int NAME_is_short(double dt)
{
    return !(dt >= NAME_SHORTEST_DT_US * (1.0 - 1e-9) * 1e-6);
}

/* Whether dt [s] is too short for a step. */
static inline int NAME_is_too_short(double dt)
{
    return NAME_MERGE_SHORT_STEPS ? !(dt > 0.0) : NAME_is_short(dt);
}

/* Add the physical inputs of a step of dt [s] to the past. */
static inline void NAME_remember(NAME_simulation *sim, const double now[], double dt)
{
    const double before = sim->length[sim->newest];
    const int merged = NAME_MERGE_SHORT_STEPS && NAME_is_short(before);
    double *value;
    int i;
    if (!merged) sim->newest = (sim->newest + 1) % NAME_HISTORY;
    sim->length[sim->newest] = merged ? before + dt : dt;
    value = sim->value[sim->newest];
    for (i = 0; i < NAME_NIN; i++) { /* of merged steps, a held input has its mean, and a line or an angle its end */
        const int mean = merged && !sim->linear[i] && !NAME_angle[i];
        value[i] = mean ? (value[i] * before + now[i] * dt) / (before + dt) : now[i];
    }
}

/* Advance the states by dt [s] with these physical inputs. The steps may differ in duration.
   The result is NAME_OK; after any other result nothing has changed. */
static inline int NAME_advance(NAME_simulation *sim, const double inputs[], double dt)
{
    double now[NAME_NIN > 0 ? NAME_NIN : 1], first[NAME_NU > 0 ? NAME_NU : 1], last[NAME_NU > 0 ? NAME_NU : 1];
    double middle[NAME_NU > 0 ? NAME_NU : 1], k1[NAME_NX], k2[NAME_NX], k3[NAME_NX], k4[NAME_NX], at[NAME_NX];
    const double *p = sim->p;
    double *x = sim->x;
    int i, part, parts = 1;
    if (NAME_is_too_short(dt)) return NAME_DT_TOO_SHORT;
    if (dt > 1000.0) return NAME_DT_TOO_LONG;
    if (dt > 1.1 * NAME_MAX_STEP) parts = (int)ceil(dt / NAME_MAX_STEP - 1e-6);
    NAME_present(sim, inputs, now);
    for (part = 0; part < parts; part++) { /* Runge-Kutta 4 with inputs on lines */
        const double start = dt * part / parts, end = dt * (part + 1) / parts, step = end - start;
        NAME_ends(sim, now, dt, start, end, first, last);
        for (i = 0; i < NAME_NU; i++) middle[i] = (first[i] + last[i]) / 2.0;
        NAME_f(x, first, p, k1);
        for (i = 0; i < NAME_NX; i++) at[i] = x[i] + step / 2.0 * k1[i];
        NAME_f(at, middle, p, k2);
        for (i = 0; i < NAME_NX; i++) at[i] = x[i] + step / 2.0 * k2[i];
        NAME_f(at, middle, p, k3);
        for (i = 0; i < NAME_NX; i++) at[i] = x[i] + step * k3[i];
        NAME_f(at, last, p, k4);
        for (i = 0; i < NAME_NX; i++) x[i] += step / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
    }
    sim->t += dt;
    sim->work += dt * NAME_power(sim, now);
    NAME_remember(sim, now, dt);
    return NAME_OK;
}

/* Outputs now, at the start of a step of dt [s] with these physical inputs. */
static inline int NAME_outputs(const NAME_simulation *sim, const double inputs[], double dt, double y[])
{
    double now[NAME_NIN > 0 ? NAME_NIN : 1], first[NAME_NU > 0 ? NAME_NU : 1], last[NAME_NU > 0 ? NAME_NU : 1];
    double end = dt;
    if (NAME_is_too_short(dt)) return NAME_DT_TOO_SHORT;
    if (dt > 1000.0) return NAME_DT_TOO_LONG;
    if (dt > 1.1 * NAME_MAX_STEP) end = dt / ceil(dt / NAME_MAX_STEP - 1e-6);
    NAME_present(sim, inputs, now);
    NAME_ends(sim, now, dt, 0.0, end, first, last);
    NAME_h(sim->x, first, sim->p, y);
    return NAME_OK;
}
"""
