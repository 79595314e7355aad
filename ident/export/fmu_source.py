"""Text of the C file of an FMU: the functions of FMI 2.0 for co-simulation, around the exported header of a model.

NAME is the prefix of the model, and GUID the identifier of the FMU. `seatrial.ident.export.fmu` writes the tables of
the parameters before this text. The declarations are those of the FMI 2.0.5 specification, written for this file.
"""

HEAD = """/* FMI 2.0 co-simulation of the model in NAME.h. An instance keeps all of its state. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NAME_SHORTEST_DT_US 1000 /* the past of the inputs is resolved to a millisecond */
#define NAME_MERGE_SHORT_STEPS 1 /* steps may be shorter */
#include "NAME.h"

/* Functions of a static library begin with the prefix; those of a shared library have none. CMake defines
   NAME_EXPORTS for a shared library, and other builds define FMI2_OVERRIDE_FUNCTION_PREFIX. */
#if defined(FMI2_OVERRIDE_FUNCTION_PREFIX) || defined(NAME_EXPORTS)
#define FMI(name) name
#else
#define FMI(name) NAME_##name
#endif
#if defined(_WIN32) || defined(__CYGWIN__)
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif
"""
SOURCE = """
typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef void (*fmi2CallbackLogger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
typedef struct {
    fmi2CallbackLogger logger;
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

/* Value references: inputs, initial states, inputs before the start, parameters, states, outputs. */
enum {
    FIRST_START = NAME_NIN,
    FIRST_BEFORE = FIRST_START + NAME_NX,
    FIRST_PARAMETER = FIRST_BEFORE + NAME_NIN,
    FIRST_STATE = FIRST_PARAMETER + NAME_NP,
    FIRST_OUTPUT = FIRST_STATE + NAME_NX,
    N_VARIABLES = FIRST_OUTPUT + NAME_NY
};

typedef enum { INSTANTIATED, INITIALISING, STEPPING, TERMINATED, FAILED } Phase;

/* Everything that a simulation changes. It contains no pointer but sim.p, so that it can be copied and saved. */
typedef struct {
    char guid[sizeof GUID];
    Phase phase;
    double start_time, time, dt; /* dt: last step, for the outputs, which are those at the start of a step */
    double input[NAME_NIN > 0 ? NAME_NIN : 1];
    double start[NAME_NX];
    double before[NAME_NIN > 0 ? NAME_NIN : 1];
    double p[NAME_NP > 0 ? NAME_NP : 1];
    NAME_simulation sim;
} State;

typedef struct {
    State state;
    char *name;
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
} Instance;

static void say(const Instance *instance, const char *text)
{
    if (instance->logger)
        instance->logger(instance->environment, instance->name, fmi2Error, "logStatusError", text);
}

static fmi2Status refuse(const Instance *instance, const char *what, const char *name, const char *why)
{
    char text[512];
    snprintf(text, sizeof text, "%s: %s%s%s", what, name, *name ? " " : "", why);
    say(instance, text);
    return fmi2Error;
}

/* Set the simulation to its start. Inputs are held between communication points. */
static void restart(State *state)
{
    int i;
    NAME_init(&state->sim, state->start, state->before, state->p);
    state->sim.t = state->start_time; /* the input t is the time of the experiment */
    for (i = 0; i < NAME_NIN; i++) state->sim.linear[i] = 0;
}

static void set_defaults(State *state)
{
    int i;
    memset(state, 0, sizeof *state);
    memcpy(state->guid, GUID, sizeof GUID);
    state->phase = INSTANTIATED;
    state->dt = DEFAULT_DT;
    for (i = 0; i < NAME_NP; i++) state->p[i] = NAME_parameters[i];
    restart(state);
}

static void copy_state(State *to, const State *from)
{
    memcpy(to, from, sizeof *to);
    to->sim.p = to->p;
}

EXPORT const char *FMI(fmi2GetTypesPlatform)(void)
{
    return "default";
}

EXPORT const char *FMI(fmi2GetVersion)(void)
{
    return "2.0";
}

EXPORT fmi2Status FMI(fmi2SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c; (void)on; (void)n; (void)categories; /* only errors are reported, and always */
    return fmi2OK;
}

EXPORT fmi2Component FMI(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    Instance *instance = calloc(1, sizeof *instance);
    const size_t length = name ? strlen(name) : 0;
    (void)resources; (void)visible; (void)logging;
    if (!instance) return NULL;
    instance->logger = functions ? functions->logger : NULL;
    instance->environment = functions ? functions->componentEnvironment : NULL;
    instance->name = malloc(length + 1);
    if (!instance->name) {
        free(instance);
        return NULL;
    }
    if (length) memcpy(instance->name, name, length);
    instance->name[length] = '\\0';
    if (type != fmi2CoSimulation || !guid || strcmp(guid, GUID) != 0) {
        refuse(instance, "fmi2Instantiate", "", type != fmi2CoSimulation ? "only co-simulation is supported"
            : "the GUID is not that of this model: modelDescription.xml and binary belong to different exports");
        free(instance->name);
        free(instance);
        return NULL;
    }
    set_defaults(&instance->state);
    return instance;
}

EXPORT void FMI(fmi2FreeInstance)(fmi2Component c)
{
    Instance *instance = c;
    if (!instance) return;
    free(instance->name);
    free(instance);
}

EXPORT fmi2Status FMI(fmi2SetupExperiment)(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
    fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop)
{
    Instance *instance = c;
    (void)tolerance_defined; (void)tolerance; (void)stop_defined; (void)stop;
    if (instance->state.phase != INSTANTIATED)
        return refuse(instance, "fmi2SetupExperiment", "", "call it once, before fmi2EnterInitializationMode");
    if (!isfinite(start)) return refuse(instance, "fmi2SetupExperiment", "startTime", "is not a finite number");
    instance->state.start_time = instance->state.time = start;
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2EnterInitializationMode)(fmi2Component c)
{
    Instance *instance = c;
    if (instance->state.phase != INSTANTIATED)
        return refuse(instance, "fmi2EnterInitializationMode", "", "the model is initialised already; reset it first");
    instance->state.phase = INITIALISING;
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2ExitInitializationMode)(fmi2Component c)
{
    Instance *instance = c;
    if (instance->state.phase != INITIALISING)
        return refuse(instance, "fmi2ExitInitializationMode", "", "call fmi2EnterInitializationMode before");
    restart(&instance->state);
    instance->state.phase = STEPPING;
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2Terminate)(fmi2Component c)
{
    Instance *instance = c;
    if (instance->state.phase != STEPPING && instance->state.phase != FAILED)
        return refuse(instance, "fmi2Terminate", "", "the model is not running");
    instance->state.phase = TERMINATED;
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2Reset)(fmi2Component c)
{
    set_defaults(&((Instance *)c)->state);
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2GetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    Instance *instance = c;
    const State *state = &instance->state;
    double y[NAME_NY > 0 ? NAME_NY : 1];
    int computed = 0;
    size_t k;
    for (k = 0; k < n; k++) {
        const fmi2ValueReference i = vr[k];
        if (i >= N_VARIABLES) return refuse(instance, "fmi2GetReal", "", "there is no variable with this reference");
        if (i < FIRST_START) value[k] = state->input[i];
        else if (i < FIRST_BEFORE) value[k] = state->start[i - FIRST_START];
        else if (i < FIRST_PARAMETER) value[k] = state->before[i - FIRST_BEFORE];
        else if (i < FIRST_STATE) value[k] = state->p[i - FIRST_PARAMETER];
        else if (i < FIRST_OUTPUT) value[k] = state->sim.x[i - FIRST_STATE];
        else {
            if (!computed && NAME_outputs(&state->sim, state->input, state->dt, y) != NAME_OK)
                return refuse(instance, "fmi2GetReal", "", "the outputs cannot be computed");
            computed = 1;
            value[k] = y[i - FIRST_OUTPUT];
        }
    }
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2SetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    Instance *instance = c;
    State *state = &instance->state;
    const int early = state->phase == INSTANTIATED || state->phase == INITIALISING;
    size_t k;
    for (k = 0; k < n; k++) { /* all are checked before any is set */
        const fmi2ValueReference i = vr[k];
        if (i >= N_VARIABLES) return refuse(instance, "fmi2SetReal", "", "there is no variable with this reference");
        if (!isfinite(value[k])) return refuse(instance, "fmi2SetReal", names[i], "is set to no finite number");
        if (i >= FIRST_STATE) return refuse(instance, "fmi2SetReal", names[i], "is a result and cannot be set");
        if (!early && state->phase != STEPPING)
            return refuse(instance, "fmi2SetReal", names[i], "cannot be set after an error or the end; reset it");
        if (!early && i >= FIRST_START && i < FIRST_PARAMETER)
            return refuse(instance, "fmi2SetReal", names[i], "can be set only before the start");
        if (i >= FIRST_PARAMETER) {
            const int j = (int)(i - FIRST_PARAMETER);
            if (value[k] < lower[j] || value[k] > upper[j] || (positive[j] && value[k] <= 0.0))
                return refuse(instance, "fmi2SetReal", names[i], "is set to a value outside its bounds");
        }
    }
    for (k = 0; k < n; k++) {
        const fmi2ValueReference i = vr[k];
        if (i < FIRST_START) state->input[i] = value[k];
        else if (i < FIRST_BEFORE) state->start[i - FIRST_START] = value[k];
        else if (i < FIRST_PARAMETER) state->before[i - FIRST_BEFORE] = value[k];
        else state->p[i - FIRST_PARAMETER] = value[k];
    }
    if (early) restart(state);
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2DoStep)(fmi2Component c, fmi2Real at, fmi2Real dt, fmi2Boolean no_return)
{
    Instance *instance = c;
    State *state = &instance->state;
    double left = dt;
    int i;
    (void)no_return;
    if (state->phase != STEPPING)
        return refuse(instance, "fmi2DoStep", "", state->phase == FAILED
            ? "an earlier step failed; reset the model" : "the model is not initialised, or terminated");
    if (!(dt > 0.0) || !isfinite(dt))
        return refuse(instance, "fmi2DoStep", "communicationStepSize", "is not a positive number");
    if (!(fabs(at - state->time) <= 1e-6 * (1.0 + fabs(at))))
        return refuse(instance, "fmi2DoStep", "currentCommunicationPoint", "is not the end of the last step");
    while (left > 0.0) { /* inputs are held, so that a long step may be divided */
        const double part = left > 1000.0 ? 1000.0 : left;
        if (NAME_advance(&state->sim, state->input, part) != NAME_OK)
            return refuse(instance, "fmi2DoStep", "", "the step cannot be computed");
        left -= part;
    }
    state->dt = dt > 1000.0 ? 1000.0 : dt;
    state->time = at + dt;
    for (i = 0; i < NAME_NX; i++) {
        if (!isfinite(state->sim.x[i])) {
            state->phase = FAILED;
            return refuse(instance, "fmi2DoStep", names[FIRST_STATE + i],
                "is no longer finite: inputs or parameters are outside the range of the model");
        }
    }
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *saved)
{
    Instance *instance = c;
    if (!*saved) *saved = malloc(sizeof(State));
    if (!*saved) return refuse(instance, "fmi2GetFMUstate", "", "there is not enough memory");
    copy_state(*saved, &instance->state);
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate saved)
{
    Instance *instance = c;
    if (!saved) return refuse(instance, "fmi2SetFMUstate", "", "there is no saved state");
    copy_state(&instance->state, saved);
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *saved)
{
    (void)c;
    free(*saved);
    *saved = NULL;
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate saved, size_t *size)
{
    (void)c; (void)saved;
    *size = sizeof(State);
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2SerializeFMUstate)(fmi2Component c, fmi2FMUstate saved, fmi2Byte bytes[], size_t size)
{
    const NAME_simulation *sim = &((const State *)saved)->sim;
    const double *none = NULL;
    if (size < sizeof(State)) return refuse(c, "fmi2SerializeFMUstate", "", "the buffer is too small");
    memcpy(bytes, saved, sizeof(State));
    memcpy(bytes + ((const char *)&sim->p - (const char *)saved), &none, sizeof none); /* an address is no state */
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size,
    fmi2FMUstate *saved)
{
    Instance *instance = c;
    if (size != sizeof(State) || memcmp(bytes, GUID, sizeof GUID) != 0)
        return refuse(instance, "fmi2DeSerializeFMUstate", "", "the bytes are not a state of this model");
    if (!*saved) *saved = malloc(sizeof(State));
    if (!*saved) return refuse(instance, "fmi2DeSerializeFMUstate", "", "there is not enough memory");
    memcpy(*saved, bytes, sizeof(State));
    ((State *)*saved)->sim.p = ((State *)*saved)->p;
    return fmi2OK;
}

/* The model has no variables of other types, and no derivatives. */
#define NO_VARIABLES(name, ...) \\
    EXPORT fmi2Status FMI(name)(fmi2Component c, const fmi2ValueReference vr[], size_t n, __VA_ARGS__ value[]) \\
    { \\
        (void)vr; (void)value; \\
        return n ? refuse(c, #name, "", "the model has only real variables") : fmi2OK; \\
    }
NO_VARIABLES(fmi2GetInteger, fmi2Integer)
NO_VARIABLES(fmi2GetBoolean, fmi2Boolean)
NO_VARIABLES(fmi2GetString, fmi2String)
NO_VARIABLES(fmi2SetInteger, const fmi2Integer)
NO_VARIABLES(fmi2SetBoolean, const fmi2Boolean)
NO_VARIABLES(fmi2SetString, const fmi2String)

EXPORT fmi2Status FMI(fmi2GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference unknown[],
    size_t n_unknown, const fmi2ValueReference known[], size_t n_known, const fmi2Real d_known[], fmi2Real d_unknown[])
{
    (void)unknown; (void)n_unknown; (void)known; (void)n_known; (void)d_known; (void)d_unknown;
    return refuse(c, "fmi2GetDirectionalDerivative", "", "is not supported");
}

EXPORT fmi2Status FMI(fmi2SetRealInputDerivatives)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
    const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr; (void)order; (void)value;
    return n ? refuse(c, "fmi2SetRealInputDerivatives", "", "is not supported: inputs are held") : fmi2OK;
}

EXPORT fmi2Status FMI(fmi2GetRealOutputDerivatives)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
    const fmi2Integer order[], fmi2Real value[])
{
    (void)vr; (void)order; (void)value;
    return n ? refuse(c, "fmi2GetRealOutputDerivatives", "", "is not supported") : fmi2OK;
}

EXPORT fmi2Status FMI(fmi2CancelStep)(fmi2Component c)
{
    return refuse(c, "fmi2CancelStep", "", "no step is running: steps end before fmi2DoStep returns");
}

EXPORT fmi2Status FMI(fmi2GetStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)c; (void)kind; (void)value;
    return fmi2Discard; /* only for steps that have not ended */
}

EXPORT fmi2Status FMI(fmi2GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Instance *)c)->state.time;
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2GetIntegerStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c; (void)kind; (void)value;
    return fmi2Discard;
}

EXPORT fmi2Status FMI(fmi2GetBooleanStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = ((Instance *)c)->state.phase == TERMINATED;
    return fmi2OK;
}

EXPORT fmi2Status FMI(fmi2GetStringStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)c; (void)kind; (void)value;
    return fmi2Discard;
}
"""
