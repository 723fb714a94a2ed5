/* FMI 2.0, Model Exchange and Co-Simulation. What a run does not need is left out on purpose, and is there but
   refuses with COMPLETE, as for FMUs that nothing else is said about. */
#include "models.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    int again, terminate, nominals_changed, values_changed, next_defined;
    double next;
} EventInfo;

typedef struct {
    void (*logger)(void *environment, const char *name, int status, const char *category, const char *message, ...);
    void *allocate, *release, *finished, *environment;
} Functions;

static void pass_on(const Logging *logging, int status, const char *message)
{
    const Functions *functions = logging->callback;
    functions->logger(logging->environment, "models", status, "logAll", message, 42);
}

EXPORT void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                             const Functions *functions, int visible, int logging)
{
    return create(guid, (Logging){pass_on, functions, functions->environment});
}
EXPORT void fmi2FreeInstance(void *c) { destroy(c); }
EXPORT int fmi2SetupExperiment(void *c, int tolerance_defined, double tolerance, double start, int stop_defined,
                               double stop)
{
    forget(c);
    ((Model *)c)->time = start;
    ((Model *)c)->stop = stop_defined ? stop : INFINITY;
    return 0;
}
EXPORT int fmi2EnterInitializationMode(void *c) { return set_up(c, ((Model *)c)->time, ((Model *)c)->stop); }
EXPORT int fmi2ExitInitializationMode(void *c)
{
    initialise(c);
    return 0;
}
EXPORT int fmi2Terminate(void *c) { return terminate(c); }

EXPORT int fmi2SetReal(void *c, const unsigned vr[], size_t n, const double value[])
{
    return set_reals(c, vr, n, value);
}
EXPORT int fmi2GetReal(void *c, const unsigned vr[], size_t n, double value[]) { return get_reals(c, vr, n, value); }
EXPORT int fmi2SetInteger(void *c, const unsigned vr[], size_t n, const int value[])
{
    for (size_t i = 0; i < n; i++)
        ((Model *)c)->values[whole(vr[i])] = value[i];
    return 0;
}
EXPORT int fmi2GetInteger(void *c, const unsigned vr[], size_t n, int value[])
{
    for (size_t i = 0; i < n; i++)
        value[i] = (int)((Model *)c)->values[whole(vr[i])];
    return 0;
}
EXPORT int fmi2SetBoolean(void *c, const unsigned vr[], size_t n, const int value[])
{
    return fmi2SetInteger(c, vr, n, value);
}
EXPORT int fmi2GetBoolean(void *c, const unsigned vr[], size_t n, int value[])
{
    return fmi2GetInteger(c, vr, n, value);
}
EXPORT int fmi2SetString(void *c, const unsigned vr[], size_t n, const char *const value[])
{
    ((Model *)c)->values[NAME_LENGTH] = (double)strlen(value[0]);
    return 0;
}

EXPORT int fmi2DoStep(void *c, double time, double h, int no_set_state)
{
    return step(c, time, h);
}
EXPORT int fmi2GetBooleanStatus(void *c, int kind, int *value)
{
    *value = kind == 3 && ((Model *)c)->terminate;
    return 0;
}

EXPORT int fmi2GetRealStatus(void *c, int kind, double *value)
{
    *value = ((Model *)c)->time;
    return kind == 2 ? 0 : 3;
}

EXPORT int fmi2EnterEventMode(void *c) { return 0; }
EXPORT int fmi2EnterContinuousTimeMode(void *c) { return 0; }
EXPORT int fmi2NewDiscreteStates(void *c, EventInfo *info)
{
    Model *m = c;
    memset(info, 0, sizeof *info);
    info->values_changed = handle_event(m);
    info->terminate = m->terminate;
    info->next_defined = m->next_event >= 0.0;
    info->next = m->next_event;
    return 0;
}
EXPORT int fmi2CompletedIntegratorStep(void *c, int no_set_state, int *event, int *terminate)
{
    *event = completed_step(c);
    *terminate = ends_after_step(c);
    return 0;
}
EXPORT int fmi2SetTime(void *c, double time)
{
    ((Model *)c)->time = time;
    return 0;
}
EXPORT int fmi2SetContinuousStates(void *c, const double x[], size_t n)
{
    memcpy(&((Model *)c)->values[X], x, n * sizeof *x);
    return 0;
}
EXPORT int fmi2GetContinuousStates(void *c, double x[], size_t n)
{
    memcpy(x, &((Model *)c)->values[X], n * sizeof *x);
    return 0;
}
EXPORT int fmi2GetNominalsOfContinuousStates(void *c, double x[], size_t n)
{
    for (size_t i = 0; i < n; i++)
        x[i] = 1.0;
    return 0;
}
EXPORT int fmi2GetDerivatives(void *c, double dx[], size_t n)
{
    /* Where the input is 99, evaluation fails. */
    if (((Model *)c)->values[U] == 99.0)
        return 3;
    return derivatives(c, dx);
}
EXPORT int fmi2GetEventIndicators(void *c, double z[], size_t n)
{
    event_indicators(c, z);
    return 0;
}

#ifdef TELLING
/* Of a lag: of the state's derivative ON times what it is, of anything else 0. */
EXPORT int fmi2GetDirectionalDerivative(void *c, const unsigned z[], size_t nz, const unsigned v[], size_t nv,
                                        const double dv[], double dz[])
{
    const double *values = ((Model *)c)->values;
    double slope = values[RATE] * values[ON];
    for (size_t i = 0; i < nz; i++) {
        dz[i] = 0.0;
        for (size_t j = 0; j < nv && z[i] == DX; j++)
            dz[i] += (v[j] == U ? slope : -slope) * dv[j];
    }
    return 0;
}
#endif

#ifdef KEEPING
EXPORT int fmi2SerializedFMUstateSize(void *c, void *state, size_t *size)
{
    *size = state_size(state);
    return 0;
}
EXPORT int fmi2SerializeFMUstate(void *c, void *state, char bytes[], size_t size)
{
    memset(bytes, 0, size);
    memcpy(bytes, state, sizeof(Model));
    return 0;
}
EXPORT int fmi2DeSerializeFMUstate(void *c, const char bytes[], size_t size, void **state)
{
    return deserialised(c, bytes, size, state);
}
EXPORT int fmi2GetFMUstate(void *c, void **state)
{
    *state = saved(c);
    return 0;
}
EXPORT int fmi2SetFMUstate(void *c, void *state)
{
    restore(c, state);
    return 0;
}
EXPORT int fmi2FreeFMUstate(void *c, void **state)
{
    free(*state);
    *state = NULL;
    return 0;
}
#endif

#ifdef COMPLETE
#define REFUSED(name, ...) \
    EXPORT int name(void *c, __VA_ARGS__) { return 3; }
EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT int fmi2Reset(void *c) { return 3; }
EXPORT int fmi2CancelStep(void *c) { return 3; }
REFUSED(fmi2SetDebugLogging, int on, size_t n, const char *const categories[])
REFUSED(fmi2GetString, const unsigned vr[], size_t n, const char *value[])
REFUSED(fmi2GetFMUstate, void **state)
REFUSED(fmi2SetFMUstate, void *state)
REFUSED(fmi2FreeFMUstate, void **state)
REFUSED(fmi2SerializedFMUstateSize, void *state, size_t *size)
REFUSED(fmi2SerializeFMUstate, void *state, char bytes[], size_t size)
REFUSED(fmi2DeSerializeFMUstate, const char bytes[], size_t size, void **state)
REFUSED(fmi2GetDirectionalDerivative, const unsigned z[], size_t nz, const unsigned v[], size_t nv, const double dv[],
        double dz[])
REFUSED(fmi2SetRealInputDerivatives, const unsigned vr[], size_t n, const int order[], const double value[])
REFUSED(fmi2GetRealOutputDerivatives, const unsigned vr[], size_t n, const int order[], double value[])
REFUSED(fmi2GetStatus, int kind, int *value)
REFUSED(fmi2GetIntegerStatus, int kind, int *value)
REFUSED(fmi2GetStringStatus, int kind, const char **value)
#endif
