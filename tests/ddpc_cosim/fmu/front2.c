/* FMI 2.0, Model Exchange and Co-Simulation; optional functions are left out on purpose. */
#include "models.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    int again, terminate, nominals_changed, values_changed, next_defined;
    double next;
} EventInfo;

EXPORT void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                             const void *functions, int visible, int logging)
{
    return create(guid);
}
EXPORT void fmi2FreeInstance(void *c) { free(c); }
EXPORT int fmi2SetupExperiment(void *c, int tolerance_defined, double tolerance, double start, int stop_defined,
                               double stop)
{
    ((Model *)c)->time = start;
    ((Model *)c)->stop = stop_defined ? stop : INFINITY;
    return 0;
}
EXPORT int fmi2EnterInitializationMode(void *c) { return 0; }
EXPORT int fmi2ExitInitializationMode(void *c)
{
    initialise(c);
    return 0;
}
EXPORT int fmi2Terminate(void *c) { return 0; }

EXPORT int fmi2SetReal(void *c, const unsigned vr[], size_t n, const double value[])
{
    for (size_t i = 0; i < n; i++) {
        if (!is_writable(vr[i]) || value[i] == -1.0)
            return 3;
        /* One parameter is ignored, as too many FMUs do. */
        if (vr[i] != RESTITUTION || value[i] != 0.123)
            ((Model *)c)->values[vr[i]] = value[i];
    }
    return 0;
}
EXPORT int fmi2GetReal(void *c, const unsigned vr[], size_t n, double value[])
{
    for (size_t i = 0; i < n; i++)
        value[i] = ((Model *)c)->values[vr[i]];
    return 0;
}
EXPORT int fmi2SetInteger(void *c, const unsigned vr[], size_t n, const int value[])
{
    for (size_t i = 0; i < n; i++)
        ((Model *)c)->values[vr[i]] = value[i];
    return 0;
}
EXPORT int fmi2GetInteger(void *c, const unsigned vr[], size_t n, int value[])
{
    for (size_t i = 0; i < n; i++)
        value[i] = (int)((Model *)c)->values[vr[i]];
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
    return time + h > ((Model *)c)->stop ? 3 : step(c, h);
}
EXPORT int fmi2GetBooleanStatus(void *c, int kind, int *value)
{
    *value = kind == 3 && ((Model *)c)->terminate;
    return 0;
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
    *terminate = 0;
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
    derivatives(c, dx);
    return 0;
}
EXPORT int fmi2GetEventIndicators(void *c, double z[], size_t n)
{
    event_indicators(c, z);
    return 0;
}
