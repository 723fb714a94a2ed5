/* FMI 3.0: the functions of the standard in terms of `instance.h`. */
#include "fmi3Functions.h"
#include "instance.h"

/* Inquiry, life cycle, saved states, derivatives (sections 2.3.2, 2.2.6 to 2.2.11). */

static void log_message(const Instance *instance, Status status, const char *category, const char *message)
{
    const fmi3LogMessageCallback callback = (fmi3LogMessageCallback)instance->logger.callback;
    callback(instance->logger.environment, (fmi3Status)status, category, message);
}

static Logger logger_of(fmi3InstanceEnvironment environment, fmi3LogMessageCallback callback)
{
    return (Logger){log_message, (AnyFunction)callback, environment};
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    return (fmi3Status)instance_set_logging(instance, loggingOn, nCategories, categories, __func__);
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage)
{
    (void)resourcePath; /* there are no resources */
    (void)visible;
    return instance_create(MODEL_EXCHANGE, instanceName, instantiationToken, loggingOn,
                           logger_of(instanceEnvironment, logMessage), __func__);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
                                         fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate)
{
    (void)resourcePath;
    (void)visible;
    (void)eventModeUsed; /* what the importer could do; the capability flags say that none of it is used */
    (void)earlyReturnAllowed;
    (void)requiredIntermediateVariables;
    (void)nRequiredIntermediateVariables;
    (void)intermediateUpdate;
    return instance_create(CO_SIMULATION, instanceName, instantiationToken, loggingOn,
                           logger_of(instanceEnvironment, logMessage), __func__);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken,
                                               fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment instanceEnvironment,
                                               fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)instanceName;
    (void)instantiationToken;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)clockUpdate;
    (void)lockPreemption;
    (void)unlockPreemption;
    if (logMessage) {
        logMessage(instanceEnvironment, fmi3Error, "logStatusError",
                   "fmi3InstantiateScheduledExecution: this FMU has no Scheduled Execution.");
    }
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance)
{
    instance_free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    const Status status = instance_define_experiment(instance, toleranceDefined ? &tolerance : NULL, startTime,
                                                     stopTimeDefined ? &stopTime : NULL, __func__);
    return status == STATUS_OK ? (fmi3Status)instance_enter_initialization(instance, __func__) : (fmi3Status)status;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return (fmi3Status)instance_exit_initialization(instance, __func__);
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    return (fmi3Status)instance_terminate(instance, __func__);
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    return (fmi3Status)instance_reset(instance, __func__);
}

static fmi3Status no_structural_parameters(const Instance *instance, const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return fmi3Error;
    return (fmi3Status)refuse(instance, STATUS_ERROR, "%s: this FMU has no structural parameters.", function);
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance)
{
    return no_structural_parameters(instance, __func__);
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance)
{
    return no_structural_parameters(instance, __func__);
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    return (fmi3Status)instance_get_state(instance, FMUState, __func__);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    return (fmi3Status)instance_set_state(instance, FMUState, __func__);
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    return (fmi3Status)instance_free_state(instance, FMUState, __func__);
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size)
{
    return (fmi3Status)instance_serialized_size(instance, FMUState, size, __func__);
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size)
{
    return (fmi3Status)instance_serialize(instance, FMUState, serializedState, size, __func__);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState)
{
    return (fmi3Status)instance_deserialize(instance, serializedState, size, FMUState, __func__);
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                        size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    if (!paired(instance, nKnowns, nSeed, __func__)) return fmi3Error;
    if (!paired(instance, nUnknowns, nSensitivity, __func__)) return fmi3Error;
    return (fmi3Status)instance_derivative(instance, false, knowns, nKnowns, seed, unknowns, nUnknowns, sensitivity,
                                           __func__);
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                    size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    if (!paired(instance, nUnknowns, nSeed, __func__)) return fmi3Error;
    if (!paired(instance, nKnowns, nSensitivity, __func__)) return fmi3Error;
    return (fmi3Status)instance_derivative(instance, true, unknowns, nUnknowns, seed, knowns, nKnowns, sensitivity,
                                           __func__);
}

/* Values of variables (section 2.2.6.2). All variables are scalars of type Float64. */

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Float64 values[], size_t nValues)
{
    if (!paired(instance, nValueReferences, nValues, __func__)) return fmi3Error;
    return (fmi3Status)instance_get(instance, valueReferences, nValueReferences, values, __func__);
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Float64 values[], size_t nValues)
{
    if (!paired(instance, nValueReferences, nValues, __func__)) return fmi3Error;
    return (fmi3Status)instance_set(instance, valueReferences, nValueReferences, values, __func__);
}

/* Named together in messages, for the size of the library. */
static const char OTHER_TYPES[] = "access to types other than Float64";

/* Both functions of a type that no variable has; twelve types differ in nothing but their names. */
#define NO_VARIABLES_OF_TYPE(Type)                                                                                    \
    fmi3Status fmi3Get##Type(fmi3Instance instance, const fmi3ValueReference valueReferences[],                       \
                             size_t nValueReferences, fmi3##Type values[], size_t nValues)                            \
    {                                                                                                                 \
        (void)valueReferences;                                                                                        \
        (void)values;                                                                                                 \
        (void)nValues;                                                                                                \
        return (fmi3Status)instance_get_other_type(instance, nValueReferences, OTHER_TYPES);                          \
    }                                                                                                                 \
    fmi3Status fmi3Set##Type(fmi3Instance instance, const fmi3ValueReference valueReferences[],                       \
                             size_t nValueReferences, const fmi3##Type values[], size_t nValues)                      \
    {                                                                                                                 \
        (void)valueReferences;                                                                                        \
        (void)values;                                                                                                 \
        (void)nValues;                                                                                                \
        return (fmi3Status)instance_set_other_type(instance, nValueReferences, OTHER_TYPES);                          \
    }

NO_VARIABLES_OF_TYPE(Float32)
NO_VARIABLES_OF_TYPE(Int8)
NO_VARIABLES_OF_TYPE(UInt8)
NO_VARIABLES_OF_TYPE(Int16)
NO_VARIABLES_OF_TYPE(UInt16)
NO_VARIABLES_OF_TYPE(Int32)
NO_VARIABLES_OF_TYPE(UInt32)
NO_VARIABLES_OF_TYPE(Int64)
NO_VARIABLES_OF_TYPE(UInt64)
NO_VARIABLES_OF_TYPE(Boolean)
NO_VARIABLES_OF_TYPE(String)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         size_t valueSizes[], fmi3Binary values[], size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return (fmi3Status)instance_get_other_type(instance, nValueReferences, OTHER_TYPES);
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const size_t valueSizes[], const fmi3Binary values[], size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return (fmi3Status)instance_set_other_type(instance, nValueReferences, OTHER_TYPES);
}

static fmi3Status no_elements(const Instance *instance, const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return fmi3Error;
    return (fmi3Status)refuse(instance, STATUS_ERROR, "%s: no dependencies per element, variables are scalars.",
                              function);
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference valueReference,
                                               size_t *nDependencies)
{
    (void)valueReference;
    (void)nDependencies;
    return no_elements(instance, __func__);
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t elementIndicesOfDependent[], fmi3ValueReference independents[],
                                       size_t elementIndicesOfIndependents[], fmi3DependencyKind dependencyKinds[],
                                       size_t nDependencies)
{
    (void)dependent;
    (void)elementIndicesOfDependent;
    (void)independents;
    (void)elementIndicesOfIndependents;
    (void)dependencyKinds;
    (void)nDependencies;
    return no_elements(instance, __func__);
}

/* Clocks (section 2.2.8), of which this FMU has none, and model partitions, which need clocks. */

/* Access to no clock succeeds, to any it fails. */
static fmi3Status no_clocks(const Instance *instance, size_t n)
{
    if (!allowed(instance, MODES_ANY, "access to clocks")) return fmi3Error;
    return n == 0 ? fmi3OK : (fmi3Status)refuse(instance, STATUS_ERROR, "This FMU has no clocks.");
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3Clock values[])
{
    (void)valueReferences;
    (void)values;
    return no_clocks(instance, nValueReferences);
}

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Clock values[])
{
    (void)valueReferences;
    (void)values;
    return no_clocks(instance, nValueReferences);
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                  size_t nValueReferences, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    (void)valueReferences;
    (void)intervals;
    (void)qualifiers;
    return no_clocks(instance, nValueReferences);
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                   size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return no_clocks(instance, nValueReferences);
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                               size_t nValueReferences, fmi3Float64 shifts[])
{
    (void)valueReferences;
    (void)shifts;
    return no_clocks(instance, nValueReferences);
}

fmi3Status fmi3GetShiftFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    return no_clocks(instance, nValueReferences);
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                  size_t nValueReferences, const fmi3Float64 intervals[])
{
    (void)valueReferences;
    (void)intervals;
    return no_clocks(instance, nValueReferences);
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                   size_t nValueReferences, const fmi3UInt64 counters[],
                                   const fmi3UInt64 resolutions[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    return no_clocks(instance, nValueReferences);
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                               size_t nValueReferences, const fmi3Float64 shifts[])
{
    (void)valueReferences;
    (void)shifts;
    return no_clocks(instance, nValueReferences);
}

fmi3Status fmi3SetShiftFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                size_t nValueReferences, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    return no_clocks(instance, nValueReferences);
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clockReference,
                                      fmi3Float64 activationTime)
{
    (void)clockReference;
    (void)activationTime;
    return no_clocks(instance, 1);
}

/* Co-Simulation (section 4.2). */

fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    if (!allowed(instance, MODES_ANY, __func__)) return fmi3Error;
    return (fmi3Status)refuse(instance, STATUS_ERROR, "%s: Co-Simulation of this FMU has no event mode.", __func__);
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn,
                      fmi3Float64 *lastSuccessfulTime)
{
    const Instance *stepped = instance;
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    if (!stepped) return fmi3Error;
    if (!present(stepped, eventHandlingNeeded, 1, __func__) || !present(stepped, terminateSimulation, 1, __func__) ||
        !present(stepped, earlyReturn, 1, __func__) || !present(stepped, lastSuccessfulTime, 1, __func__)) {
        return fmi3Error;
    }
    const Status status = instance_do_step(instance, currentCommunicationPoint, communicationStepSize, __func__);
    *eventHandlingNeeded = fmi3False;
    *terminateSimulation = fmi3False;
    *earlyReturn = fmi3False;
    *lastSuccessfulTime = simulation_time(stepped->simulation);
    return (fmi3Status)status;
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Int32 orders[], fmi3Float64 values[],
                                    size_t nValues)
{
    (void)valueReferences;
    (void)orders;
    (void)values;
    (void)nValues;
    if (!allowed(instance, MODES_ANY, __func__)) return fmi3Error;
    if (nValueReferences == 0) return fmi3OK;
    return (fmi3Status)refuse(instance, STATUS_ERROR, "%s: outputs have no derivatives.", __func__);
}

/* Model Exchange (section 3.2) and the functions of event mode (section 2.3.5). */

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
