/* FMI 3.0, Model Exchange and Co-Simulation; optional functions are left out on purpose. */
#include "models.h"

#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

EXPORT void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources, bool visible,
                                          bool logging, void *environment, void *log)
{
    return create(token);
}
EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                         bool logging, bool event_mode, bool early_return, const unsigned required[],
                                         size_t n, void *environment, void *log, void *update)
{
    return create(token);
}
EXPORT void fmi3FreeInstance(void *c) { free(c); }
EXPORT int fmi3EnterInitializationMode(void *c, bool tolerance_defined, double tolerance, double start,
                                       bool stop_defined, double stop)
{
    ((Model *)c)->time = start;
    return 0;
}
EXPORT int fmi3ExitInitializationMode(void *c)
{
    initialise(c);
    return 0;
}
EXPORT int fmi3Terminate(void *c) { return 0; }

EXPORT int fmi3SetFloat64(void *c, const unsigned vr[], size_t n, const double value[], size_t count)
{
    for (size_t i = 0; i < n; i++) {
        if (!is_writable(vr[i]) || value[i] == -1.0)
            return 3;
        ((Model *)c)->values[vr[i]] = value[i];
    }
    return 0;
}
EXPORT int fmi3GetFloat64(void *c, const unsigned vr[], size_t n, double value[], size_t count)
{
    for (size_t i = 0; i < n; i++)
        value[i] = ((Model *)c)->values[vr[i]];
    return 0;
}
EXPORT int fmi3GetInt32(void *c, const unsigned vr[], size_t n, int32_t value[], size_t count)
{
    for (size_t i = 0; i < n; i++)
        value[i] = (int32_t)((Model *)c)->values[vr[i]];
    return 0;
}
EXPORT int fmi3SetString(void *c, const unsigned vr[], size_t n, const char *const value[], size_t count)
{
    ((Model *)c)->values[NAME_LENGTH] = (double)strlen(value[0]);
    return 0;
}

EXPORT int fmi3DoStep(void *c, double time, double h, bool no_set_state, bool *event, bool *terminate, bool *early,
                      double *reached)
{
    int status = step(c, h);
    *event = *early = false;
    *terminate = status != 0;
    *reached = time + h;
    return status;
}

EXPORT int fmi3EnterEventMode(void *c) { return 0; }
EXPORT int fmi3EnterContinuousTimeMode(void *c) { return 0; }
EXPORT int fmi3UpdateDiscreteStates(void *c, bool *again, bool *terminate, bool *nominals, bool *values,
                                    bool *next_defined, double *next)
{
    Model *m = c;
    *values = handle_event(m);
    *again = *nominals = false;
    *terminate = m->terminate;
    *next_defined = m->next_event >= 0.0;
    *next = m->next_event;
    return 0;
}
EXPORT int fmi3CompletedIntegratorStep(void *c, bool no_set_state, bool *event, bool *terminate)
{
    *event = completed_step(c);
    *terminate = false;
    return 0;
}
EXPORT int fmi3SetTime(void *c, double time)
{
    ((Model *)c)->time = time;
    return 0;
}
EXPORT int fmi3SetContinuousStates(void *c, const double x[], size_t n)
{
    memcpy(&((Model *)c)->values[X], x, n * sizeof *x);
    return 0;
}
EXPORT int fmi3GetContinuousStates(void *c, double x[], size_t n)
{
    memcpy(x, &((Model *)c)->values[X], n * sizeof *x);
    return 0;
}
EXPORT int fmi3GetNominalsOfContinuousStates(void *c, double x[], size_t n)
{
    for (size_t i = 0; i < n; i++)
        x[i] = 1.0;
    return 0;
}
EXPORT int fmi3GetContinuousStateDerivatives(void *c, double dx[], size_t n)
{
    derivatives(c, dx);
    return 0;
}
EXPORT int fmi3GetEventIndicators(void *c, double z[], size_t n)
{
    event_indicators(c, z);
    return 0;
}
