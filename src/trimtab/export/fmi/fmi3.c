/* This text may be used, changed and passed on for any purpose, under any licence or none, without notice; it comes
 * without warranty. */

/* Co-simulation by FMI 3.0, based on fmu.h. */
#include "fmi3Functions.h"
#include "fmu.h"

#define STATUS(good) ((good) ? fmi3OK : fmi3Error)
#define REFERENCES fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences
#define UNUSED_REFERENCES (void)instance, (void)valueReferences, (void)nValueReferences

static void say(const fmu *f, const char *text)
{
    if (f->logger)
        ((fmi3LogMessageCallback)f->logger)(f->environment, fmi3Error, "logStatusError", text);
}

static double fmu_time(const fmu *f)
{
    return f->kept.start + (double)f->kept.clock.now / FMU_TICKS;
}

/* Set a 64-bit integer, which a double cannot represent exactly. */
static void fmu_set_whole(fmu *f, const fmu_variable *v, uint32_t element, const void *value)
{
    memcpy((char *)&f->kept.data + v->offset + element * sizeof(int64_t), value, sizeof(int64_t));
    if (f->kept.mode <= FMU_INITIALISING)
        f->kept.begun = false;
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    (void)instance, (void)loggingOn, (void)nCategories, (void)categories;
    return fmi3OK;
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
    (void)resourcePath, (void)visible, (void)loggingOn, (void)eventModeUsed, (void)earlyReturnAllowed;
    (void)requiredIntermediateVariables, (void)nRequiredIntermediateVariables, (void)intermediateUpdate;
    return fmu_create(instanceName, instantiationToken, instanceEnvironment, (void (*)(void))logMessage, say);
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage)
{
    (void)instanceName, (void)instantiationToken, (void)resourcePath, (void)visible, (void)loggingOn;
    if (logMessage)
        logMessage(instanceEnvironment, fmi3Error, "logStatusError", "this FMU supports only co-simulation");
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken,
                                               fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment instanceEnvironment,
                                               fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)clockUpdate, (void)lockPreemption, (void)unlockPreemption;
    return fmi3InstantiateModelExchange(instanceName, instantiationToken, resourcePath, visible, loggingOn,
                                        instanceEnvironment, logMessage);
}

void fmi3FreeInstance(fmi3Instance instance) { fmu_free((fmu *)instance); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    (void)toleranceDefined, (void)tolerance, (void)stopTimeDefined, (void)stopTime;
    return STATUS(fmu_enter_initialization((fmu *)instance, startTime));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return STATUS(fmu_exit_initialization((fmu *)instance));
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    ((fmu *)instance)->kept.mode = FMU_ENDED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    fmu_reset((fmu *)instance);
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    const bool good = fmu_step((fmu *)instance, currentCommunicationPoint, communicationStepSize);
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    *lastSuccessfulTime = good ? currentCommunicationPoint + communicationStepSize : fmu_time((fmu *)instance);
    return STATUS(good);
}

static bool get_values(fmu *f, const fmi3ValueReference *references, size_t count, char *values, size_t n, uint8_t type)
{
    const char *const end = values + n * fmu_sizes[type];
    for (size_t i = 0; i < count; i++) {
        const fmu_variable *v;
        if (references[i] == 0 && type == FMU_F64 && values < end) {
            const double now = fmu_time(f);
            memcpy(values, &now, sizeof now);
            values += sizeof now;
            continue;
        }
        const char *const at = fmu_look(f, references[i], &v);
        if (!at)
            return false;
        const size_t size = v->count * fmu_sizes[type];
        if (v->type != type || (size_t)(end - values) < size)
            return fmu_fail(f, v->name, "the variable has another type or size");
        memcpy(values, at, size);
        values += size;
    }
    return values == end || fmu_fail(f, "values", "more values were given than the variables have");
}

static bool set_values(fmu *f, const fmi3ValueReference *references, size_t count, const char *values, size_t n,
                       uint8_t type)
{
    const char *const end = values + n * fmu_sizes[type];
    for (size_t i = 0; i < count; i++) {
        const fmu_variable *const v = fmu_find(f, references[i]);
        if (!v || !fmu_may_set(f, v))
            return false;
        if (v->type != type || (size_t)(end - values) < v->count * fmu_sizes[type])
            return fmu_fail(f, v->name, "the variable has another type or size");
        for (uint32_t k = 0; k < v->count; k++, values += fmu_sizes[type]) {
            if (type == FMU_I64)
                fmu_set_whole(f, v, k, values);
            else if (!fmu_set(f, v, k, fmu_read(values, type)))
                return false;
        }
    }
    return values == end || fmu_fail(f, "values", "more values were given than the variables have");
}

#define ACCESS(Name, type)                                                                                             \
    fmi3Status fmi3Get##Name(REFERENCES, fmi3##Name values[], size_t nValues)                                          \
    {                                                                                                                  \
        return STATUS(get_values((fmu *)instance, valueReferences, nValueReferences, (char *)values, nValues, type));  \
    }                                                                                                                  \
    fmi3Status fmi3Set##Name(REFERENCES, const fmi3##Name values[], size_t nValues)                                    \
    {                                                                                                                  \
        return STATUS(                                                                                                 \
            set_values((fmu *)instance, valueReferences, nValueReferences, (const char *)values, nValues, type));      \
    }

ACCESS(Float64, FMU_F64)
ACCESS(Float32, FMU_F32)
ACCESS(Int32, FMU_I32)
ACCESS(Int64, FMU_I64)
ACCESS(UInt32, FMU_U32)
ACCESS(Boolean, FMU_BOOL)

/* No variable has one of these types. */
#define NO_ACCESS(Name)                                                                                                \
    fmi3Status fmi3Get##Name(REFERENCES, fmi3##Name values[], size_t nValues)                                          \
    {                                                                                                                  \
        UNUSED_REFERENCES, (void)values, (void)nValues;                                                                \
        return STATUS(nValueReferences == 0);                                                                          \
    }                                                                                                                  \
    fmi3Status fmi3Set##Name(REFERENCES, const fmi3##Name values[], size_t nValues)                                    \
    {                                                                                                                  \
        UNUSED_REFERENCES, (void)values, (void)nValues;                                                                \
        return STATUS(nValueReferences == 0);                                                                          \
    }

NO_ACCESS(Int8)
NO_ACCESS(UInt8)
NO_ACCESS(Int16)
NO_ACCESS(UInt16)
NO_ACCESS(UInt64)
NO_ACCESS(String)

fmi3Status fmi3GetBinary(REFERENCES, size_t valueSizes[], fmi3Binary values[], size_t nValues)
{
    UNUSED_REFERENCES, (void)valueSizes, (void)values, (void)nValues;
    return STATUS(nValueReferences == 0);
}

fmi3Status fmi3SetBinary(REFERENCES, const size_t valueSizes[], const fmi3Binary values[], size_t nValues)
{
    UNUSED_REFERENCES, (void)valueSizes, (void)values, (void)nValues;
    return STATUS(nValueReferences == 0);
}

fmi3Status fmi3GetClock(REFERENCES, fmi3Clock values[])
{
    UNUSED_REFERENCES, (void)values;
    return STATUS(nValueReferences == 0);
}

fmi3Status fmi3SetClock(REFERENCES, const fmi3Clock values[])
{
    UNUSED_REFERENCES, (void)values;
    return STATUS(nValueReferences == 0);
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    return STATUS((*FMUState = fmu_save((fmu *)instance, (fmu_snapshot *)*FMUState)) != NULL);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    return STATUS(fmu_restore((fmu *)instance, (const fmu_snapshot *)FMUState));
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    (void)instance;
    if (FMUState) {
        free(*FMUState);
        *FMUState = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size)
{
    (void)instance, (void)FMUState;
    *size = sizeof(fmu_snapshot);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size)
{
    (void)instance;
    if (size < sizeof(fmu_snapshot))
        return fmi3Error;
    memcpy(serializedState, FMUState, sizeof(fmu_snapshot));
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState)
{
    return STATUS((*FMUState = fmu_deserialize((fmu *)instance, serializedState, size)) != NULL);
}

/* Functions for features that this FMU does not have, according to its model description. */
#define ABSENT(name, ...)                                                                                              \
    fmi3Status name(__VA_ARGS__)                                                                                       \
    {                                                                                                                  \
        return fmi3Error;                                                                                              \
    }

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
ABSENT(fmi3EnterEventMode, fmi3Instance instance)
ABSENT(fmi3EnterStepMode, fmi3Instance instance)
ABSENT(fmi3EnterConfigurationMode, fmi3Instance instance)
ABSENT(fmi3ExitConfigurationMode, fmi3Instance instance)
ABSENT(fmi3EnterContinuousTimeMode, fmi3Instance instance)
ABSENT(fmi3EvaluateDiscreteStates, fmi3Instance instance)
ABSENT(fmi3GetNumberOfVariableDependencies, fmi3Instance instance, fmi3ValueReference valueReference,
       size_t *nDependencies)
ABSENT(fmi3GetVariableDependencies, fmi3Instance instance, fmi3ValueReference dependent,
       size_t elementIndicesOfDependent[], fmi3ValueReference independents[], size_t elementIndicesOfIndependents[],
       fmi3DependencyKind dependencyKinds[], size_t nDependencies)
ABSENT(fmi3GetDirectionalDerivative, fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
       const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
       fmi3Float64 sensitivity[], size_t nSensitivity)
ABSENT(fmi3GetAdjointDerivative, fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
       const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
       fmi3Float64 sensitivity[], size_t nSensitivity)
ABSENT(fmi3GetIntervalDecimal, REFERENCES, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
ABSENT(fmi3GetIntervalFraction, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
       fmi3IntervalQualifier qualifiers[])
ABSENT(fmi3GetShiftDecimal, REFERENCES, fmi3Float64 shifts[])
ABSENT(fmi3GetShiftFraction, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
ABSENT(fmi3SetIntervalDecimal, REFERENCES, const fmi3Float64 intervals[])
ABSENT(fmi3SetIntervalFraction, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
ABSENT(fmi3SetShiftDecimal, REFERENCES, const fmi3Float64 shifts[])
ABSENT(fmi3SetShiftFraction, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
ABSENT(fmi3UpdateDiscreteStates, fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
       fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
       fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime)
ABSENT(fmi3CompletedIntegratorStep, fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation)
ABSENT(fmi3SetTime, fmi3Instance instance, fmi3Float64 time)
ABSENT(fmi3SetContinuousStates, fmi3Instance instance, const fmi3Float64 continuousStates[], size_t nContinuousStates)
ABSENT(fmi3GetContinuousStateDerivatives, fmi3Instance instance, fmi3Float64 derivatives[], size_t nContinuousStates)
ABSENT(fmi3GetEventIndicators, fmi3Instance instance, fmi3Float64 eventIndicators[], size_t nEventIndicators)
ABSENT(fmi3GetContinuousStates, fmi3Instance instance, fmi3Float64 continuousStates[], size_t nContinuousStates)
ABSENT(fmi3GetNominalsOfContinuousStates, fmi3Instance instance, fmi3Float64 nominals[], size_t nContinuousStates)
ABSENT(fmi3GetNumberOfEventIndicators, fmi3Instance instance, size_t *nEventIndicators)
ABSENT(fmi3GetNumberOfContinuousStates, fmi3Instance instance, size_t *nContinuousStates)
ABSENT(fmi3GetOutputDerivatives, REFERENCES, const fmi3Int32 orders[], fmi3Float64 values[], size_t nValues)
ABSENT(fmi3ActivateModelPartition, fmi3Instance instance, fmi3ValueReference clockReference, fmi3Float64 activationTime)
