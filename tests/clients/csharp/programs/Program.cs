// Runs one of the test programs; each prints JSON on standard output.

using System;
using System.Collections.Generic;
using System.IO;
using Adverb;

static class Program
{
    static int Main(string[] arguments)
    {
        switch (arguments[0])
        {
            case "wire": Print(WireVectors.Run(Read(arguments[1]))); return 0;
            case "jitter": Print(JitterRuns.Run(Read(arguments[1]))); return 0;
            case "evaluate": Print(EvaluatorRuns.Vectors(Read(arguments[1]), arguments[2])); return 0;
            case "replay": Print(ReplayRuns.Run(arguments[1], Read(arguments[2]), arguments[3])); return 0;
            case "damage": Print(EvaluatorRuns.Damage(arguments[1])); return 0;
            case "server":
                Print(EvaluatorRuns.Server(arguments[1], int.Parse(arguments[2])).GetAwaiter().GetResult()); return 0;
            case "flip": Print(Flipped(arguments[1])); return 0;
            case "bench": Print(EvaluatorRuns.Bench(arguments[1], arguments[2])); return 0;
            case "rest":
                Print(RestRuns.Run(arguments[1], Json.ParseObject(arguments[2])).GetAwaiter().GetResult()); return 0;
            case "stream": return new Driver(Json.ParseObject(arguments[1])).Run().GetAwaiter().GetResult();
            default: return 2;
        }
    }

    static Dictionary<string, object> Read(string path)
    {
        return Json.ParseObject(File.ReadAllText(path));
    }

    static float[] Flipped(string values)
    {
        float[] found = Json.Parse(values).Singles();
        Frames.FlipPose(found);
        return found;
    }

    internal static void Print(object value)
    {
        lock (Console.Out)
        {
            Console.Out.WriteLine(Json.Write(value));
            Console.Out.Flush();
        }
    }
}

/// <summary>Short access to parsed JSON.</summary>
static class Fields
{
    internal static double Num(this object value)
    {
        return Convert.ToDouble(value);
    }

    internal static Dictionary<string, object> Map(this object value)
    {
        return (Dictionary<string, object>)value;
    }

    internal static List<object> List(this object value)
    {
        return (List<object>)value;
    }

    internal static double[] Nums(this object value)
    {
        return List(value).ConvertAll(each => Num(each)).ToArray();
    }

    internal static float[] Singles(this object value)
    {
        return List(value).ConvertAll(each => (float)Num(each)).ToArray();
    }

    internal static object OrNull(this Dictionary<string, object> fields, string name)
    {
        object found;
        fields.TryGetValue(name, out found);
        return found;
    }

    internal static byte[] Bytes(this object hex)
    {
        var text = (string)hex;
        var found = new byte[text.Length / 2];
        for (int k = 0; k < found.Length; k++) found[k] = Convert.ToByte(text.Substring(2 * k, 2), 16);
        return found;
    }

    internal static string Hex(this byte[] content)
    {
        return BitConverter.ToString(content).Replace("-", "").ToLowerInvariant();
    }

    internal static object Finite(double value)
    {
        return double.IsNaN(value) ? null : (object)value;
    }
}
