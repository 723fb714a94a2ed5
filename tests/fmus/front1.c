/* FMI 1.0, Model Exchange and Co-Simulation in one library, which FMI 1.0 does not forbid. */
#include "models.h"

#include <math.h>
#include <string.h>

typedef struct {
    char converged, references_changed, values_changed, terminate, upcoming;
    double next;
} EventInfo;

typedef struct { void *logger, *allocate, *release, *finished; } Callbacks;

static void *begin(const char *guid) { return create(guid, (Logging){0}); }

EXPORT void *models_fmiInstantiateModel(const char *name, const char *guid, Callbacks functions, char logging)
{
    return begin(guid);
}
EXPORT void *models_fmiInstantiateSlave(const char *name, const char *guid, const char *location, const char *mime,
                                        double timeout, char visible, char interactive, Callbacks functions,
                                        char logging)
{
    return begin(guid);
}
EXPORT void models_fmiFreeModelInstance(void *c) { destroy(c); }
EXPORT void models_fmiFreeSlaveInstance(void *c) { destroy(c); }
EXPORT int models_fmiTerminate(void *c) { return terminate(c); }
EXPORT int models_fmiTerminateSlave(void *c) { return terminate(c); }

EXPORT int models_fmiSetReal(void *c, const unsigned vr[], size_t n, const double value[])
{
    return set_reals(c, vr, n, value);
}
EXPORT int models_fmiGetReal(void *c, const unsigned vr[], size_t n, double value[])
{
    return get_reals(c, vr, n, value);
}
EXPORT int models_fmiSetInteger(void *c, const unsigned vr[], size_t n, const int value[])
{
    for (size_t i = 0; i < n; i++)
        ((Model *)c)->values[whole(vr[i])] = value[i];
    return 0;
}
EXPORT int models_fmiGetInteger(void *c, const unsigned vr[], size_t n, int value[])
{
    for (size_t i = 0; i < n; i++)
        value[i] = (int)((Model *)c)->values[whole(vr[i])];
    return 0;
}
EXPORT int models_fmiSetBoolean(void *c, const unsigned vr[], size_t n, const char value[])
{
    for (size_t i = 0; i < n; i++)
        ((Model *)c)->values[whole(vr[i])] = value[i];
    return 0;
}
EXPORT int models_fmiGetBoolean(void *c, const unsigned vr[], size_t n, char value[])
{
    for (size_t i = 0; i < n; i++)
        value[i] = (char)((Model *)c)->values[whole(vr[i])];
    return 0;
}
EXPORT int models_fmiSetString(void *c, const unsigned vr[], size_t n, const char *const value[])
{
    ((Model *)c)->values[NAME_LENGTH] = (double)strlen(value[0]);
    return 0;
}

EXPORT int models_fmiInitializeSlave(void *c, double start, char stop_defined, double stop)
{
    int status = set_up(c, start, stop_defined ? stop : INFINITY);
    initialise(c);
    return status;
}
EXPORT int models_fmiDoStep(void *c, double time, double h, char new_step) { return step(c, time, h); }

static void tell(Model *m, EventInfo *info, int jumped)
{
    info->converged = 1;
    info->references_changed = 0;
    info->values_changed = (char)jumped;
    info->terminate = (char)m->terminate;
    info->upcoming = m->next_event >= 0.0;
    info->next = m->next_event;
}
EXPORT int models_fmiInitialize(void *c, char tolerance_controlled, double tolerance, EventInfo *info)
{
    int status = set_up(c, ((Model *)c)->time, INFINITY);
    initialise(c);
    tell(c, info, 0);
    return status;
}
EXPORT int models_fmiEventUpdate(void *c, char intermediate, EventInfo *info)
{
    int jumped = handle_event(c);
    tell(c, info, jumped);
    return 0;
}
EXPORT int models_fmiCompletedIntegratorStep(void *c, char *event)
{
    *event = (char)completed_step(c);
    return 0;
}
EXPORT int models_fmiSetTime(void *c, double time)
{
    ((Model *)c)->time = time;
    return 0;
}
EXPORT int models_fmiSetContinuousStates(void *c, const double x[], size_t n)
{
    memcpy(&((Model *)c)->values[X], x, n * sizeof *x);
    return 0;
}
EXPORT int models_fmiGetContinuousStates(void *c, double x[], size_t n)
{
    memcpy(x, &((Model *)c)->values[X], n * sizeof *x);
    return 0;
}
EXPORT int models_fmiGetNominalContinuousStates(void *c, double x[], size_t n)
{
    for (size_t i = 0; i < n; i++)
        x[i] = 1.0;
    return 0;
}
EXPORT int models_fmiGetDerivatives(void *c, double dx[], size_t n)
{
    return derivatives(c, dx);
}
EXPORT int models_fmiGetEventIndicators(void *c, double z[], size_t n)
{
    event_indicators(c, z);
    return 0;
}
