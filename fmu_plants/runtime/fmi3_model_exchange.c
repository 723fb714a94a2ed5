/* FMI 3.0 for Model Exchange (section 3.2) and the functions of event mode (section 2.3.5). */
#include "fmi3Functions.h"
#include "instance.h"

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    return (fmi3Status)instance_enter_event_mode(instance, __func__);
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance)
{
    return allowed(instance, MODE_INITIALIZATION | MODE_EVENT, __func__) ? fmi3OK : fmi3Error;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
                                    fmi3Float64 *nextEventTime)
{
    fmi3Boolean *const results[] = {discreteStatesNeedUpdate, terminateSimulation, nominalsOfContinuousStatesChanged,
                                    valuesOfContinuousStatesChanged, nextEventTimeDefined};
    enum { N_RESULTS = sizeof results / sizeof results[0] };
    if (!allowed(instance, MODE_EVENT, __func__) || !present(instance, nextEventTime, 1, __func__)) return fmi3Error;
    for (size_t i = 0; i < N_RESULTS; ++i) {
        if (!present(instance, results[i], 1, __func__)) return fmi3Error;
    }
    for (size_t i = 0; i < N_RESULTS; ++i) *results[i] = fmi3False;
    *nextEventTime = 0.0;
    return fmi3OK;
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    return (fmi3Status)instance_enter_continuous_time_mode(instance, __func__);
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    if (!allowed(instance, MODE_CONTINUOUS_TIME, __func__) || !present(instance, enterEventMode, 1, __func__) ||
        !present(instance, terminateSimulation, 1, __func__)) {
        return fmi3Error;
    }
    *enterEventMode = fmi3False;
    *terminateSimulation = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    return (fmi3Status)instance_set_time(instance, time, __func__);
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[],
                                   size_t nContinuousStates)
{
    return (fmi3Status)instance_set_states(instance, continuousStates, nContinuousStates, __func__);
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[],
                                             size_t nContinuousStates)
{
    return (fmi3Status)instance_get_derivatives(instance, derivatives, nContinuousStates, __func__);
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 eventIndicators[], size_t nEventIndicators)
{
    return (fmi3Status)instance_get_event_indicators(instance, eventIndicators, nEventIndicators, __func__);
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 continuousStates[], size_t nContinuousStates)
{
    return (fmi3Status)instance_get_states(instance, continuousStates, nContinuousStates, __func__);
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t nContinuousStates)
{
    return (fmi3Status)instance_get_nominals(instance, nominals, nContinuousStates, __func__);
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators)
{
    if (!allowed(instance, MODES_ANY, __func__) || !present(instance, nEventIndicators, 1, __func__)) return fmi3Error;
    *nEventIndicators = 0;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates)
{
    if (!allowed(instance, MODES_ANY, __func__) || !present(instance, nContinuousStates, 1, __func__)) {
        return fmi3Error;
    }
    *nContinuousStates = model.n_states;
    return fmi3OK;
}
